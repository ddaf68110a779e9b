"""Keeps what an episode of the expert did, for its page in a browser."""

from __future__ import annotations

import numpy as np

from planners.execution.controlled_env import ControlledEnv
from planners.tamp.recording import Frame, Note, Recording, Solve
from planners.tamp.solution import Infeasible, Solution

__all__ = ["Recorder"]


class Recorder:
    """Collects frames, plans and deviations of one episode; a frame of 15 objects takes 0.5 kB."""

    def __init__(self, env: ControlledEnv, target: str) -> None:
        self._model, self._data = env.model, env.data
        self._target, self._objects = target, env.object_names
        self._started = float(env.data.time)
        self._frames: list[Frame] = []
        self._solves: list[Solve] = []
        self._notes: list[Note] = []

    @property
    def _now(self) -> float:
        return float(self._data.time) - self._started

    def step(self, action: int = -1, phase: str = "") -> None:
        """Keep the state before a control step, and what the robot does in it."""
        self._frames.append(self._frame(action, phase))

    def solved(self, outcome: Solution | Infeasible) -> None:
        """Keep the result of a solve."""
        self._solves.append(Solve(self._now, outcome))

    def note(self, text: str) -> None:
        """Keep a deviation."""
        self._notes.append(Note(self._now, text))

    def recording(self) -> Recording:
        """All that was kept, and the present state."""
        frames = [*self._frames]
        if not frames or self._now > frames[-1].time:
            frames.append(self._frame(-1, ""))
        return Recording(
            self._model, self._target, self._objects, tuple(frames), tuple(self._solves), tuple(self._notes)
        )

    def _frame(self, action: int, phase: str) -> Frame:
        return Frame(self._now, self._data.qpos.astype(np.float32), len(self._solves) - 1, action, phase)
