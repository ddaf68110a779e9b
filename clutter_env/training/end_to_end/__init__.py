"""Training of the end-to-end policy by imitation of canonical plans."""
