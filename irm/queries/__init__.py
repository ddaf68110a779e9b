"""Where may the base stand? Inverse maps (equations 4 and 5) and placement queries for one or several TCP poses."""
