"""Measurements of the base poses that queries answer with."""
