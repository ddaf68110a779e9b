"""How fast the environments are, how they endure, how their layouts look."""
