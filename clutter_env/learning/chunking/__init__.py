"""Reference learners of motions: action chunks and flow matching."""
