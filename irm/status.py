"""Answers whether a pose is in reach: YES, NO or UNKNOWN."""

from __future__ import annotations

from enum import Enum

NO, UNKNOWN, YES = 0, 1, 2
"""Answers of solvers and kernels: the values of `Status`."""


class Status(Enum):
    """YES: certainly possible. NO: certainly impossible. UNKNOWN: the cells of the map are too coarse to decide."""

    NO = NO
    UNKNOWN = UNKNOWN
    YES = YES
