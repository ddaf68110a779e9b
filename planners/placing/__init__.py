"""Where can an object be put? The negative goal region (eq. 1-3), swept volumes and placement locations."""
