"""Tables and objects: layouts and the random scenes drawn on them."""
