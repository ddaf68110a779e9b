"""The environments: Retrieve, Reach, Pick and Skill."""
