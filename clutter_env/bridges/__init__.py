"""Other people's environments, solved by the planner and scored by their own check. Also our environments for
LeRobot."""
