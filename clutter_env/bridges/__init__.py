"""Other people's environments, solved by the planner and scored by their own check; ours, as LeRobot sees them."""
