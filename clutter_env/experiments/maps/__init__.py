"""Reachability maps measured and drawn."""
