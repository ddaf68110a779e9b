"""Checks of a map's answers: YES, UNKNOWN or NO for a TCP pose, and exact verification of base poses."""
