"""Training of the weights that come with the package; `python -m scripts.shipped_weights --help`."""
