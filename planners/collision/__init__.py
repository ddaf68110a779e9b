"""Compiled collision checks of configurations and motions in a scene, with one bit per object."""
