"""Comparison of policies and experts on the same held-out scenes."""
