"""The console command `clutter-env`."""
