"""The choice of objects to clear and of their order: lower bound, commitments and look-ahead."""
