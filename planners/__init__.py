"""Task and motion planning: what to do, in which order, along which path."""
