"""Which objects must be cleared, and in which order? Minimum clearances, commitments and look-ahead."""
