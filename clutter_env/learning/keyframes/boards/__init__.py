"""Motions under a board: where the base stands is geometry, what the arm does there is learned."""
