"""Table 1 of Lee & Kim 2019."""

__all__ = ["PAPER", "PAPER_OBJECTS"]

PAPER_OBJECTS = (15, 20, 25, 30, 35, 40)
PAPER = {
    "clearances": {"srivastava": (3.4, 6.6, 7.5, 8.2, 10.7, 11.2), "ngr": (3.0, 5.0, 5.0, 6.0, 6.0, 6.0)},
    "duplicated": {"srivastava": (0.3, 0.7, 1.2, 1.6, 2.3, 3.0), "ngr": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)},
}
"""Objects cleared, and objects cleared twice or more, by strategy, for `PAPER_OBJECTS`."""
