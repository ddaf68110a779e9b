"""The three possible answers of a map."""

from __future__ import annotations

from enum import Enum

__all__ = ["Status"]


class Status(Enum):
    """YES: certainly possible. NO: certainly impossible. UNKNOWN: the cells of the map are too coarse to decide."""

    NO = 0
    UNKNOWN = 1
    YES = 2
