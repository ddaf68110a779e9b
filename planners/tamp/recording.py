"""An episode as it was executed, or a plan as it would be: what a page in a browser shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from planners.tamp.solution import SolveStats

__all__ = ["Frame", "Note", "Outcome", "Recording", "Solve"]


class Outcome(Protocol):
    """What a solve returns: `Solution`, whose `to_html` makes a recording, or `Infeasible`."""

    @property
    def stats(self) -> SolveStats:
        """Counts, times and the task plans that were refuted."""
        ...

    def summary(self) -> str:
        """The plan, or the failure, in words."""
        ...


class Solve(NamedTuple):
    """The result of a solve, and the time [s] of the episode at which it was made."""

    time: float
    outcome: Outcome


class Note(NamedTuple):
    """What happened at a time [s] of the episode, such as "object_03: toppled"."""

    time: float
    text: str


class Frame(NamedTuple):
    """The world at one control step.

    Attributes:
        time: [s] since the episode began.
        qpos: (nq,) positions of all joints of the model.
        solve: number of the solve whose plan is executed, -1 before the first.
        action: number of the action of that plan; its length after the last one, -1 while the robot waits.
        phase: of the action's motion; "" while the robot waits.
    """

    time: float
    qpos: NDArray[np.float32]
    solve: int
    action: int
    phase: str


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames, plans and notes in order of time.

    Attributes:
        model: whose joints the frames hold.
        target: name of the object to retrieve.
        objects: names of the bodies that may be moved.
        frames: one for each control step, at least one.
        solves: the first plan and those after deviations.
        notes: the deviations.
    """

    model: mujoco.MjModel
    target: str
    objects: tuple[str, ...]
    frames: tuple[Frame, ...]
    solves: tuple[Solve, ...]
    notes: tuple[Note, ...] = ()
