"""Finding a target that no camera sees: what cameras show, where the target can still be, what to do next."""
