"""What a solve returns: a plan whose references are bound, or the reason there is none."""

from __future__ import annotations

from dataclasses import dataclass, field

from planners.cause import Cause
from planners.motion.trajectory import Trajectory

__all__ = ["BoundAction", "Infeasible", "ReplanRecord", "Solution", "SolveStats"]


@dataclass(frozen=True)
class BoundAction:
    """A ground action of the task plan whose references are bound to a motion.

    Attributes:
        name: action of the PDDL domain, as in Fig. 4 of Lee & Kim 2019.
        args: the symbols of the action, references included.
        trajectory: the verified motion behind the references.
        target: the object that is moved or approached, "" for a base motion.
    """

    name: str
    args: tuple[str, ...]
    trajectory: Trajectory
    target: str = ""

    def __str__(self) -> str:
        return f"{self.name.upper()} ({' '.join(self.args).upper()})"


@dataclass(frozen=True)
class ReplanRecord:
    """One turn of Algorithm 1's loop, for printing as in Fig. 11.

    Attributes:
        plan: the task plan that was tried, as text, one action each.
        verified: how many of its actions were bound.
        refuted: the action that motion planning refuted, "" for none.
        new_facts: facts learnt from the refutation, as text.
    """

    plan: tuple[str, ...]
    verified: int
    refuted: str
    new_facts: tuple[str, ...]


@dataclass(frozen=True)
class SolveStats:
    """Counts and CPU times [s] of one solve."""

    replans: int = 0
    task_plans: int = 0
    task_planning_s: float = 0.0
    motion_planning_s: float = 0.0
    total_s: float = 0.0
    history: tuple[ReplanRecord, ...] = field(default=(), repr=False)


@dataclass(frozen=True)
class Solution:
    """A feasible plan F of Algorithm 1: every reference is bound to a verified motion.

    Attributes:
        actions: bound actions in order.
        clearances: names of the objects put aside, in order; a name twice was cleared twice.
        stats: counts and times.
    """

    actions: tuple[BoundAction, ...]
    clearances: tuple[str, ...]
    stats: SolveStats

    @property
    def duplicated(self) -> tuple[str, ...]:
        """Objects cleared twice or more (Table 1, right half)."""
        return tuple(sorted({name for name in self.clearances if self.clearances.count(name) > 1}))


@dataclass(frozen=True)
class Infeasible:
    """No plan was found.

    Attributes:
        cause: which of the ways to fail it was.
        detail: one sentence with the evidence.
        objects: the objects the evidence is about.
        clearances: what had been cleared in the part of the plan that was verified.
        stats: counts and times.
    """

    cause: Cause
    detail: str
    objects: tuple[str, ...] = ()
    clearances: tuple[str, ...] = ()
    stats: SolveStats = SolveStats()
