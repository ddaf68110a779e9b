"""The three answers of a map."""

from __future__ import annotations

from enum import Enum

__all__ = ["Status"]


class Status(Enum):
    """YES and NO are never wrong; UNKNOWN says that the cells are too coarse to tell."""

    NO = 0
    UNKNOWN = 1
    YES = 2
