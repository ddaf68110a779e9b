"""A table of proved answers: for every cell of wrist centres and approach axes, where the arm certainly reaches."""
