"""Episodes of the expert in physics: one shown in full, or many counted."""
