"""The learned high-level policy: which object to pick next and from where, and where to place it."""
