"""Training: cloning, DAgger, and reinforcement learning."""
