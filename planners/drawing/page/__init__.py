"""One page for a browser: an episode or a plan in 3-D on a time line. It needs neither a network nor another file."""
