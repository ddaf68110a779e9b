"""Policies: from observations to actions. `protocol.py` says how to add one."""
