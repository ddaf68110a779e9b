"""Search for a target that no camera sees yet: perception, belief of the target's place, choice of the next action."""
