"""Demonstrations, cloned and reinforced policies, and their comparison with the expert; torch where it is needed."""
