"""Timed motions of the whole robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.scene import HeldObject

CONTROL_STEP = 0.05
"""Time [s] between commands."""


class Phase(NamedTuple):
    """A part of a trajectory.

    Attributes:
        name: name of the phase.
        start: start time [s].
        held: name of the held object, "" for none.
        touched: the object between the fingers, from the start of closing to the end of opening.
    """

    name: str
    start: float
    held: str = ""
    touched: HeldObject | None = None


def is_contact(phase: Phase) -> bool:
    """Whether the fingers close on an object or release it."""
    return phase.touched is not None and not phase.held


class TrajectorySample(NamedTuple):
    """The commanded state at one time: `base` (3,), `q` (8,), position of one finger [m], the phase."""

    base: NDArray[np.float64]
    q: NDArray[np.float64]
    finger_position: float
    phase: Phase


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Commands at control steps, linear in between. Arrays are read-only.

    Attributes:
        times: (n,) times [s] from 0.
        base: (n, 3) x [m], y [m], yaw [rad], continuous, not wrapped.
        q: (n, 8) torso [m] and arm [rad].
        finger_position: (n,) position [m] of one finger.
        phases: the phases in order of time, the first one from 0.

    Raises:
        ValueError: the arrays differ in length or are empty, or no phase starts at 0.
    """

    times: NDArray[np.float64]
    base: NDArray[np.float64]
    q: NDArray[np.float64]
    finger_position: NDArray[np.float64]
    phases: tuple[Phase, ...]

    def __post_init__(self) -> None:
        n = len(self.times)
        for name in ("times", "base", "q", "finger_position"):
            array = np.array(getattr(self, name), dtype=float)
            if len(array) != n or n == 0:
                raise ValueError(f"{name} has {len(array)} samples, times has {n}; at least one is needed")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if not self.phases or self.phases[0].start > 0:
            raise ValueError("a trajectory needs phases from time 0 on")

    @classmethod
    def of_states(cls, states: NDArray[np.float64], phase: Phase) -> Trajectory:
        """A trajectory of one phase, from its `states` (n, 12) at control steps."""
        times = np.asarray(CONTROL_STEP * np.arange(len(states)), np.float64)
        return cls(times, states[:, :3], states[:, 3:-1], states[:, -1], (phase._replace(start=0.0),))

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.times[-1])

    @property
    def held(self) -> str:
        """Name of the object that is held at the end, "" for none."""
        return self.phases[-1].held

    @property
    def states(self) -> NDArray[np.float64]:
        """Base, torso and arm, finger position (n, 12)."""
        return np.column_stack([self.base, self.q, self.finger_position])

    def phase(self, time: float) -> Phase:
        """Phase at a time [s]."""
        return [phase for phase in self.phases if phase.start <= max(time, 0.0)][-1]

    def sample(self, time: float) -> TrajectorySample:
        """Commanded state at a time [s], clipped to the trajectory's duration."""
        time = min(max(time, 0.0), self.duration)
        i = min(int(np.searchsorted(self.times, time, side="right")), len(self.times) - 1)
        before = max(i - 1, 0)
        span = self.times[i] - self.times[before]
        s = (time - self.times[before]) / span if span > 0 else 1.0
        base, q, finger = (x[before] + s * (x[i] - x[before]) for x in (self.base, self.q, self.finger_position))
        return TrajectorySample(base, q, float(finger), self.phase(time))


def join(pieces: list[Trajectory]) -> Trajectory:
    """Join trajectories in order. Each must start with the last sample of the one before."""
    first = pieces[0]
    states, times, phases, start = [first.states], [first.times], list(first.phases), first.duration
    for piece in pieces[1:]:
        states.append(piece.states[1:])
        times.append(piece.times[1:] + start)
        phases += [phase._replace(start=phase.start + start) for phase in piece.phases]
        start += piece.duration
    X = np.vstack(states)
    return Trajectory(np.concatenate(times), X[:, :3], X[:, 3:-1], X[:, -1], tuple(phases))


def phases_of(trajectory: Trajectory) -> list[Trajectory]:
    """Split a trajectory into its phases. Each begins with the last sample of the one before."""
    starts = [round(phase.start / CONTROL_STEP) for phase in trajectory.phases]
    ends, states = [*starts[1:], len(trajectory.times) - 1], trajectory.states
    return [
        Trajectory.of_states(states[start : end + 1], phase)
        for start, end, phase in zip(starts, ends, trajectory.phases, strict=True)
    ]
