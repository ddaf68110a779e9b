"""The three possible answers of a map."""

from __future__ import annotations

from enum import Enum

from irm.arm import answers

__all__ = ["Status"]


class Status(Enum):
    """YES: certainly possible. NO: certainly impossible. UNKNOWN: the cells of the map are too coarse to decide."""

    NO = answers.NO
    UNKNOWN = answers.OPEN
    YES = answers.YES
