"""Learned decisions: which object to take next and from where, and where to put down the one that is held."""
