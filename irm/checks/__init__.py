"""How far a map can be trusted: YES, UNKNOWN or NO for a hand pose, and verification of base poses."""
