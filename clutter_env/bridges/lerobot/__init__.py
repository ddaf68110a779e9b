"""Plugin that LeRobot imports, where it is installed, to find the environments."""
