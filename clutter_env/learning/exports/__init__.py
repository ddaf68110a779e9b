"""Demonstrations in the formats of other tools: LeRobot, Minari, robomimic, one HDF5 file."""
