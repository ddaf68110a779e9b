"""Opening: a hand takes a handle and moves what it opens; and what has to be opened before a goal can be reached."""
