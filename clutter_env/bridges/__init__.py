"""Other people's environments, solved by the planner through their own `step` and scored by their own check."""
