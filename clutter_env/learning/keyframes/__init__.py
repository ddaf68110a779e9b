"""Movers that are learned from demonstrations as keyframes."""
