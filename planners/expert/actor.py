"""What a robot does, one control step at a time: motions in turn, and decisions between them.

Both experts are such an agenda. A phase of theirs (plan, execute, watch, replan, home) is a decision: a method that
returns the steps to take in its place.

    plan -> follow the plan -> watch how it ended -> wait, check the result
     ^                          | deviation                | not reached
     +------- wait, replan -----+--------------------------+
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.collision.scene_arrays import robot_arrays
from planners.expert.executor import Command, Executor
from planners.expert.monitor import Snapshot
from planners.motion.arm import unwrap_joints
from planners.motion.trajectory import CONTROL_STEP

Array = NDArray[np.float64]

AT_START = 2
"""Control steps at the start of a plan after a motion: it begins at the measured joint angles, not at those commanded
last. The difference together with the first motion would exceed the acceleration limit, and the joint would lag."""
_NEAR_HOME = 0.05
"""[m], [rad]: a configuration this near to home is planned from as if it were home; the controller closes the gap."""


class Motion:
    """Something that the robot does for a number of control steps: commands until it is over.

    Attributes:
        is_over: no command is left.
    """

    is_over = False

    def command(self, last: Command) -> Command:
        """The next command, after the last one that was given."""
        raise NotImplementedError


Step: TypeAlias = "Motion | Callable[[], Sequence[Step]]"
"""A motion, or a decision: it takes no time, and returns the steps to take in its place."""
Steps: TypeAlias = Sequence[Step]


class Actor:
    """Takes the steps of an agenda: `decide` goes on to the next motion, `command` continues it.

    An expert that sees the world at once decides right after a motion's last command. One that has to wait for its next
    observation decides before the command that follows it.

    Attributes:
        motion: what the robot does; None while there is nothing to do.
        last: the command given last.
    """

    def __init__(self, last: Command, *agenda: Step) -> None:
        self.motion: Motion | None = None
        self.last = last
        self._agenda = list(agenda)

    @property
    def is_idle(self) -> bool:
        """Whether nothing is left to do."""
        return self.motion is None and not self._agenda

    @property
    def executor(self) -> Executor | None:
        """That of the plan which is followed; None during other motions."""
        return self.motion.executor if isinstance(self.motion, Follow) else None

    @property
    def phase(self) -> str:
        """Action and phase of the plan's motion, for example "PickUp object_03: lift"; "" during other motions."""
        return "" if self.executor is None else self.executor.phase

    def decide(self) -> None:
        """Take decisions until a motion is under way or nothing is left."""
        while self.motion is None or self.motion.is_over:
            self.motion = None
            if not self._agenda:
                return
            step = self._agenda.pop(0)
            if isinstance(step, Motion):
                self.motion = step
            else:
                self._agenda[:0] = step()

    def command(self) -> Command:
        """The next command of the motion; without one the last command again."""
        if self.motion is not None:
            self.last = self.motion.command(self.last)
        return self.last


class Wait(Motion):
    """Rest where the robot was sent last, while the head may turn to a pan and tilt (2,) [rad]."""

    def __init__(self, steps: int, head: Array | None = None) -> None:
        self._left, self._head = steps, head
        self.is_over = steps <= 0

    def command(self, last: Command) -> Command:
        """The last command again."""
        self._left -= 1
        self.is_over = self._left <= 0
        return last._replace(head=self._head)


class Follow(Motion):
    """Follow a plan until its end or a deviation, see `Executor`; what became of it is for a decision after it.

    Args:
        executor: of the plan.
        read: what the world is like now, for the arm of a name.
        head: (2,) pan and tilt meanwhile [rad]; None: as they are.
    """

    def __init__(self, executor: Executor, read: Callable[[str], Snapshot], head: Array | None = None) -> None:
        self.executor, self._read, self._head = executor, read, head

    def command(self, last: Command) -> Command:  # noqa: ARG002  the plan says it
        """The next command of the plan."""
        command = self.executor.advance(self._read(self.executor.arm))
        self.is_over = self.executor.is_over
        return command._replace(head=self._head)


class Straight(Motion):
    """Move all joints together from a whole-body configuration (11,) to another one, from rest to rest."""

    def __init__(self, start: Array, goal: Array, seconds: float) -> None:
        self._start, self._goal = start, goal
        self._steps, self._step = max(math.ceil(seconds / CONTROL_STEP), 1), 0

    def command(self, last: Command) -> Command:
        """The next point of the line."""
        self._step += 1
        self.is_over = self._step == self._steps
        share = self._step / self._steps
        drive = self._start + (self._goal - self._start) * share * share * (3 - 2 * share)
        return last._replace(drive=drive, head=None)


def straight_seconds(robot: RobotSpec, start: Array, goal: Array, speed: float) -> float:
    """[s] that a `Straight` motion takes with a share of the robot's largest velocities and accelerations."""
    away = np.abs(goal - start) / speed
    # A cubic is 1.5 times as fast as on average, and starts 6 times as hard.
    by_speed, by_force = 1.5 * away / robot.max_velocity, np.sqrt(6 * away / np.array(robot.max_acceleration))
    return float(np.maximum(by_speed, by_force).max())


def home_of(robot: RobotSpec, q: Array) -> Array:
    """The home configuration (1 + n,) of torso and arm, unwrapped to the turns that its joints have in another one."""
    return np.asarray(unwrap_joints(robot_arrays(robot), q, np.array(robot.home)))


def planned_from(robot: RobotSpec, q: Array) -> Array:
    """The configuration (1 + n,) of torso and arm to plan from: exactly home where they are near it."""
    home = home_of(robot, q)
    return home if np.abs(q - home).max() <= _NEAR_HOME else q
