"""One page for a browser: an episode or a plan in 3-D on a time line. It needs no network and no other file."""
