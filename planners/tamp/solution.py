"""What a solve returns: a plan whose references are bound to motions, or the reason why there is none."""

from __future__ import annotations

import importlib
import reprlib
import textwrap
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from planners.cause import Cause
from planners.strategies import Strategy
from planners.tamp.bound_action import BoundAction
from planners.tamp.plan_file import PlanFileError, read_plan, write_plan
from planners.tamp.solve_stats import ReplanRecord, SolveStats

__all__ = ["BoundAction", "Infeasible", "PlanFileError", "ReplanRecord", "Solution", "SolveStats"]

_EVIDENCE = 70
"""Characters of the evidence that the repr of an `Infeasible` shows."""


@dataclass(frozen=True, repr=False)
class Solution:
    """A feasible plan F of Algorithm 1: every reference is bound to a verified motion.

    Two solutions are equal if all their fields are, scenes and trajectories included.

    Example:
        solution = solve(scene, "object_03")
        print(solution.summary())
        solution.save("plan.npz")
        Solution.load("plan.npz").plot()

    Attributes:
        actions: bound actions in order.
        clearances: names of the objects put aside, in order; an object cleared twice is named twice.
        stats: counts and times.
        target: name of the object that the plan takes.
        strategy: the strategy that made the plan.
    """

    actions: tuple[BoundAction, ...]
    clearances: tuple[str, ...]
    stats: SolveStats
    target: str
    strategy: Strategy

    def __repr__(self) -> str:
        return (
            f"Solution(target={reprlib.repr(self.target)}, strategy={reprlib.repr(self.strategy.name)}, "
            f"actions={len(self.actions)}, clearances={len(self.clearances)}, duration={self.duration:.1f} s)"
        )

    @property
    def duplicated(self) -> tuple[str, ...]:
        """Objects cleared twice or more (Table 1, right half)."""
        return tuple(sorted({name for name in self.clearances if self.clearances.count(name) > 1}))

    @property
    def duration(self) -> float:
        """[s] of simulated time that the motions take."""
        return sum(action.trajectory.duration for action in self.actions)

    def summary(self) -> str:
        """The plan in words, several lines: target, clearances and their locations, length, times."""
        puts = [action for action in self.actions if action.is_clearance]
        lines = [f"Plan that takes {self.target}, made by strategy {self.strategy.name!r}"]
        lines.append(f"Clearances: {len(puts) or 'none'}")
        lines += [f"  {number}. {_clearance(action)}" for number, action in enumerate(puts, start=1)]
        rows = {
            "Actions": str(len(self.actions)),
            "Simulated duration": f"{self.duration:.1f} s",
            **self.stats.rows(),
        }
        return "\n".join([*lines, *(f"{name}: {value}" for name, value in rows.items())])

    def save(self, path: str | Path) -> None:
        """Write the plan, the scenes of its actions included, to one `.npz` file without pickled objects.

        Raises:
            PlanFileError: the plan holds something that the file format does not know.
            OSError: the file cannot be written.
        """
        write_plan(path, self)

    @classmethod
    def load(cls, path: str | Path) -> Solution:
        """Read a plan that `save` wrote; it is equal to the saved one, trajectories bit for bit.

        Raises:
            FileNotFoundError: no such file.
            PlanFileError: the file is damaged or holds no plan of this version.
        """
        return read_plan(path, cls)

    def plot(self, ax: Any = None) -> Any:
        """Draw the plan from above: objects, clearances in order, the way of the base.

        Args:
            ax: matplotlib axes to draw in; a new figure without it.

        Returns:
            The axes.

        Raises:
            ValueError: the plan has no actions.
        """
        # The drawing room stands above this one and needs matplotlib; planning must not import either of them.
        drawing = importlib.import_module("planners.drawing.overview")
        return drawing.draw_overview(self, ax)

    def to_html(self, path: str | Path) -> None:
        """Write the plan as one page for a browser, which needs no network: its motions in 3-D on a time line.

        Beside the motions, as planned and without physics: the actions, negative goal regions and candidates of each
        clearance, base poses of the reachability map, paths of the gripper, replanning.

        Raises:
            ValueError: the plan has no actions.
            OSError: the file cannot be written.
        """
        drawing = importlib.import_module("planners.drawing.page.planned")
        drawing.write_plan_page(self, Path(path))


@dataclass(frozen=True, repr=False)
class Infeasible:
    """No plan was found.

    Attributes:
        cause: why the search failed.
        detail: one sentence with the evidence.
        objects: the objects that the evidence is about.
        clearances: what had been cleared in the part of the plan that was verified.
        stats: counts and times.
        target: name of the object that was to be taken.
        strategy: the strategy that was tried.
    """

    cause: Cause
    detail: str
    objects: tuple[str, ...] = ()
    clearances: tuple[str, ...] = ()
    stats: SolveStats = field(default_factory=SolveStats)
    target: str = ""
    strategy: Strategy | None = None

    def __repr__(self) -> str:
        detail = textwrap.shorten(self.detail, _EVIDENCE, placeholder=" ...")
        return f"Infeasible(target={reprlib.repr(self.target)}, cause={str(self.cause)!r}, detail={detail!r})"

    def summary(self) -> str:
        """The failure in words, several lines: target, cause, evidence, times."""
        by = f", with strategy {self.strategy.name!r}" if self.strategy else ""
        rows = {
            "Cause": str(self.cause),
            "Evidence": self.detail,
            "Objects concerned": ", ".join(self.objects) or "none",
            "Cleared before the failure": ", ".join(self.clearances) or "none",
            **self.stats.rows(),
        }
        lines = [f"No plan takes {self.target or 'the target'}{by}"]
        return "\n".join([*lines, *(f"{name}: {value}" for name, value in rows.items())])

    def save(self, path: str | Path) -> None:
        """Write the result to one `.npz` file without pickled objects.

        Raises:
            OSError: the file cannot be written.
        """
        write_plan(path, self)

    @classmethod
    def load(cls, path: str | Path) -> Infeasible:
        """Read a result that `save` wrote.

        Raises:
            FileNotFoundError: no such file.
            PlanFileError: the file is damaged or holds no result of this version.
        """
        return read_plan(path, cls)


def _clearance(action: BoundAction) -> str:
    """One clearance in words: the object, where it is put, and what it obstructs."""
    body = action.released
    where = "" if body is None else f" to x = {body.position[0]:.2f} m, y = {body.position[1]:.2f} m"
    because = f", because it obstructs {action.obstructed}" if action.obstructed else ""
    return f"{action.target}{where}{because}"
