"""Cameras, pictures and films."""
