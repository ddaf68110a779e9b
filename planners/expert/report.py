"""Report and recording of an episode."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from planners.contact import contacts
from planners.expert.interfaces import ControlledEnv
from planners.grasping.families import Family
from planners.scene import Scene
from planners.tamp.solution import Infeasible, Solution, html_table


@dataclass(frozen=True)
class EpisodeReport:
    """Results of an episode.

    Attributes:
        planned: whether the last solve found a plan.
        executed: whether the last plan was executed to its end.
        scored: whether the target is held up.
        clean: whether it is held up, and no object has fallen or been disturbed since the environment's reset, by the
            counts in the environment's info. None if the environment lacks these counts.
        failure: the reason for failure, "" for success.
        clearances: objects put aside in the simulation, in order.
        duplicated: objects put aside more than once.
        replans: number of plans after the first one.
        floor: minimum number of objects that any plan must clear, and of drawers and doors that it must open. None if
            it is unknown.
        planning_s: CPU time [s] of planning.
        sim_s: simulated time [s] since reset.
        contacts: number of grasps and releases in all plans of the episode.
        not_straight: number of those without a base that faces the gripper with the gripper's yaw. A canonical planner
            had to fall back there.
        deviations: the deviations that stopped plans, as text, such as "object_03: toppled".
    """

    planned: bool = False
    executed: bool = False
    scored: bool = False
    clean: bool | None = None
    failure: str = ""
    clearances: tuple[str, ...] = ()
    duplicated: tuple[str, ...] = ()
    replans: int = 0
    floor: int | None = None
    planning_s: float = 0.0
    sim_s: float = 0.0
    contacts: int = 0
    not_straight: int = 0
    deviations: tuple[str, ...] = ()

    @property
    def result(self) -> str:
        """Result of the episode: "success", the reason of failure, or a flaw of the success."""
        if not self.scored:
            return self.failure or "the target was not held up"
        return "success" if self.clean is not False else "an object has fallen or been disturbed"

    def rows(self) -> dict[str, str]:
        """The results in words, by name."""
        flags = (self.planned, self.executed, self.scored)
        return {
            "planned, executed, scored": ", ".join("yes" if done else "no" for done in flags),
            "objects cleared": f"{len(self.clearances)} ({', '.join(self.clearances) or 'none'})",
            "cleared twice or more": str(len(self.duplicated)),
            "lower bound of clearances": "not proved" if self.floor is None else str(self.floor),
            "replans after deviations": f"{self.replans} ({'; '.join(self.deviations)})" if self.replans else "0",
            "planning": f"{self.planning_s:.2f} s of CPU time",
            "simulated time": f"{self.sim_s:.1f} s",
        }

    def __str__(self) -> str:
        return "\n".join(f"{name}: {value}" for name, value in {"result": self.result, **self.rows()}.items())

    def _repr_html_(self) -> str:
        return html_table(str(self))

    def with_solve(self, outcome: Solution | Infeasible, seconds: float) -> EpisodeReport:
        """Report after a solve that took this CPU time [s]."""
        planned = contacts(outcome)
        return replace(
            self,
            planned=isinstance(outcome, Solution),
            planning_s=self.planning_s + seconds,
            contacts=self.contacts + len(planned),
            not_straight=self.not_straight + sum(not contact.is_straight for contact in planned),
        )

    def with_clearances(self, names: list[str]) -> EpisodeReport:
        """Report after more clearances."""
        clearances = (*self.clearances, *names)
        duplicated = tuple(sorted({name for name in clearances if clearances.count(name) > 1}))
        return replace(self, clearances=clearances, duplicated=duplicated)


class Solve(NamedTuple):
    """Result of a solve, and what it was made from.

    Attributes:
        time: time [s] in the episode at which it was made.
        outcome: the result, or the report of a search.
        scene: the scene that was planned for. None if unknown.
        grasps: the grasp set that was planned with, () if unknown.
    """

    time: float
    outcome: Any
    scene: Scene | None = None
    grasps: tuple[Family, ...] = ()


class Note(NamedTuple):
    """A deviation such as "object_03: toppled", and its time [s] in the episode."""

    time: float
    text: str


class Frame(NamedTuple):
    """The world at one control step.

    Attributes:
        time: time [s] since the episode began.
        qpos: (nq,) positions of all joints of the model.
        solve: index of the solve whose plan is executed, -1 before the first.
        action: index of the action of that plan. Its number of actions after the last one, -1 while the robot waits.
        phase: phase of the action's motion, "" while the robot waits.
    """

    time: float
    qpos: NDArray[np.float32]
    solve: int
    action: int
    phase: str


@dataclass(frozen=True, eq=False)
class Recording:
    """Recording of an executed episode, or of a plan, in order of time, for a page in a browser.

    Attributes:
        model: the model with the joints of the frames.
        target: name of the object to retrieve.
        objects: names of the bodies that may be moved.
        frames: one for each control step, at least one.
        solves: the first plan and the plans after deviations.
        notes: the deviations.
    """

    model: mujoco.MjModel
    target: str
    objects: tuple[str, ...]
    frames: tuple[Frame, ...]
    solves: tuple[Solve, ...]
    notes: tuple[Note, ...] = ()


class Recorder:
    """Collects frames, plans and deviations of one episode. A frame of 15 objects takes 0.5 kB."""

    def __init__(self, env: ControlledEnv, target: str) -> None:
        self._model, self._data, self._target, self._objects = env.model, env.data, target, env.object_names
        self._started = float(env.data.time)
        self._frames: list[Frame] = []
        self._solves: list[Solve] = []
        self._notes: list[Note] = []

    @property
    def _now(self) -> float:
        return float(self._data.time) - self._started

    def _frame(self, action: int = -1, phase: str = "") -> Frame:
        return Frame(self._now, self._data.qpos.astype(np.float32), len(self._solves) - 1, action, phase)

    def add_frame(self, action: int = -1, phase: str = "") -> None:
        """Keep the state before a control step, with action and phase."""
        self._frames.append(self._frame(action, phase))

    def add_solve(self, outcome: Any, scene: Scene | None = None, grasps: tuple[Family, ...] = ()) -> None:
        """Keep the result of a solve, or the report of a search, which may grow later. See `Solve`."""
        self._solves.append(Solve(self._now, outcome, scene, grasps))

    def add_note(self, text: str) -> None:
        """Keep a deviation."""
        self._notes.append(Note(self._now, text))

    def recording(self) -> Recording:
        """Everything kept, and the present state."""
        is_later = not self._frames or self._now > self._frames[-1].time
        last = self._frames[-1] if self._frames else None
        # In the middle of an action the present state belongs to it.
        goes_on = last is not None and last.solve == len(self._solves) - 1
        present = self._frame(last.action, last.phase) if goes_on and last is not None else self._frame()
        frames = (*self._frames, *[present] * is_later)
        return Recording(self._model, self._target, self._objects, frames, tuple(self._solves), tuple(self._notes))
