"""Reachability maps: cells, orientations, equations 1 to 3, files and the user's cache."""
