"""Training: cloning, reinforcement learning, and the levels of two-level policies."""
