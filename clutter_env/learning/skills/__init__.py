"""Skills: which of them lead to the target, and a network that learns it."""
