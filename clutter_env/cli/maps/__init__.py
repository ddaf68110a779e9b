"""Sub-commands of `clutter-env map`."""
