"""Work in parallel: processes of this machine, or Ray."""
