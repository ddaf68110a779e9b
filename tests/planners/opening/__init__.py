"""Tests of what opens."""
