"""Skills: clear one object from one direction, or take the target."""
