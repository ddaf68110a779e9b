"""What a solve did: its task plans, the facts learnt, the times."""

from __future__ import annotations

from dataclasses import dataclass, field

__all__ = ["ReplanRecord", "SolveStats"]


@dataclass(frozen=True)
class ReplanRecord:
    """One turn of Algorithm 1's loop, for printing as in Fig. 11.

    Attributes:
        plan: the task plan that was tried, as text, one action each.
        verified: how many of its actions were bound.
        refuted: the action that motion planning refuted, "" for none.
        new_facts: facts learnt from the refutation, as text.
        reason: why motion planning refuted the action, "" for none.
    """

    plan: tuple[str, ...]
    verified: int
    refuted: str
    new_facts: tuple[str, ...]
    reason: str = ""


@dataclass(frozen=True)
class SolveStats:
    """Counts and CPU times [s] of one solve."""

    replans: int = 0
    task_plans: int = 0
    task_planning_s: float = 0.0
    motion_planning_s: float = 0.0
    total_s: float = 0.0
    history: tuple[ReplanRecord, ...] = field(default=(), repr=False)

    def rows(self) -> dict[str, str]:
        """Times and counts in words, for the summary of a plan."""
        return {
            "Planning time": f"{self.total_s:.2f} s of CPU time",
            "Replans": f"{self.replans} (task plans: {self.task_plans})",
        }
