"""Demonstrations, imitation and reinforcement learning, and comparison of policies with the expert."""
