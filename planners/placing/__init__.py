"""Places for an object: the negative goal region (eq. 1-3), swept volumes and placement locations."""
