"""Policies: networks, features, baselines, and those of training runs."""
