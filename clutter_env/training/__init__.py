"""Training of policies from rewards."""
