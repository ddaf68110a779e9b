"""Policies: networks, features, baselines, and agents loaded from training runs."""
