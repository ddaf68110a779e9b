"""Demonstrations: recorded, kept if they replay, stored and exported."""
