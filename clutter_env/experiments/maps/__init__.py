"""Figures and measurements of reachability maps."""
