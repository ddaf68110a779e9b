"""Paths among obstacles from random trees, and how they are shortened and smoothed."""
