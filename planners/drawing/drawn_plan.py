"""What is drawn of a plan, so that `Solution`, whose methods call this room, need not be imported here."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from planners.strategies import Strategy
from planners.tamp.solution import BoundAction, SolveStats

__all__ = ["DrawnPlan"]


class DrawnPlan(Protocol):
    """What is drawn of a plan: `planners.Solution`, whose methods call this room."""

    @property
    def target(self) -> str:
        """The object wanted."""
        ...

    @property
    def strategy(self) -> Strategy:
        """The strategy that made the plan."""
        ...

    @property
    def clearances(self) -> Sequence[str]:
        """The objects put aside, in order."""
        ...

    @property
    def actions(self) -> Sequence[BoundAction]:
        """The actions in order."""
        ...

    @property
    def stats(self) -> SolveStats:
        """Counts, times and the task plans that were refuted."""
        ...

    def summary(self) -> str:
        """The plan in words."""
        ...
