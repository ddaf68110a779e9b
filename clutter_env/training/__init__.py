"""Training: cloning, DAgger, reinforcement learning, and the levels of two-level policies."""
