"""Training: examples, fits and training runs."""
