"""Motion planning and whole plans measured and checked."""
