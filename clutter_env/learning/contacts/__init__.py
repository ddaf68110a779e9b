"""Policies in two levels: deciders choose contacts, movers bring them about."""
