"""Agenda of a robot, one control step at a time: motions in turn, and decisions between them.

Both experts are such an agenda. Their phases (plan, execute, watch, replan, home) are decisions. A decision is a method
that returns the steps to take in its place.

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
"""Control steps at the start of a plan after a motion. The plan begins at the measured joint angles, not at the last
commanded ones. The difference together with the first motion would exceed the acceleration limit, and the joint would
lag."""
_NEAR_HOME = 0.05
"""Distance [m], [rad] from home up to which the planner starts from home itself. The controller closes the gap."""


class Motion:
    """A motion over a number of control steps: it gives commands until it is over.

    Attributes:
        is_over: whether no command is left.
    """

    is_over = False

    def command(self, last: Command) -> Command:
        """Next command, after the last given command."""
        raise NotImplementedError


Step: TypeAlias = "Motion | Callable[[], Sequence[Step]]"
"""A motion, or a decision. A decision takes no time, and returns the steps to take in its place."""
Steps: TypeAlias = Sequence[Step]


class Actor:
    """Runs the steps of an agenda: `decide` goes on to the next motion, `command` continues it.

    An expert with immediate observations decides right after a motion's last command. An expert that must wait for its
    next observation decides one control step later.

    Attributes:
        motion: the present motion. None at the end.
        last: the last given command.
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
        """Executor of the present plan, None during other motions."""
        return self.motion.executor if isinstance(self.motion, Follow) else None

    @property
    def phase(self) -> str:
        """Action and phase of the plan's motion, for example "PickUp object_03: lift". "" during other motions."""
        return "" if self.executor is None else self.executor.phase

    def decide(self) -> None:
        """Make decisions until a motion is under way or nothing is left."""
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
        """Next command of the motion. Without a motion, the last command again."""
        if self.motion is not None:
            self.last = self.motion.command(self.last)
        return self.last


class Wait(Motion):
    """Rest at the last command, while the head may turn to a pan and tilt (2,) [rad]."""

    def __init__(self, steps: int, head: Array | None = None) -> None:
        self._left, self._head = steps, head
        self.is_over = steps <= 0

    def command(self, last: Command) -> Command:
        """The last command again."""
        self._left -= 1
        self.is_over = self._left <= 0
        return last._replace(head=self._head)


class Follow(Motion):
    """Follow a plan until its end or a deviation, see `Executor`. A decision after it handles the outcome.

    Args:
        executor: the executor of the plan.
        read: function for the present snapshot, by the name of an arm.
        head: (2,) pan and tilt [rad] meanwhile. None leaves them as they are.
    """

    def __init__(self, executor: Executor, read: Callable[[str], Snapshot], head: Array | None = None) -> None:
        self.executor, self._read, self._head = executor, read, head

    def command(self, last: Command) -> Command:  # noqa: ARG002  the plan says it
        """Next command of the plan."""
        command = self.executor.advance(self._read(self.executor.arm))
        self.is_over = self.executor.is_over
        return command._replace(head=self._head)


class Straight(Motion):
    """Move all joints together on a straight line between whole-body configurations (11,), from rest to rest."""

    def __init__(self, start: Array, goal: Array, seconds: float) -> None:
        self._start, self._goal = start, goal
        self._steps, self._step = max(math.ceil(seconds / CONTROL_STEP), 1), 0

    def command(self, last: Command) -> Command:
        """Next point of the line."""
        self._step += 1
        self.is_over = self._step == self._steps
        share = self._step / self._steps
        drive = self._start + (self._goal - self._start) * share * share * (3 - 2 * share)
        return last._replace(drive=drive, head=None)


def straight_seconds(robot: RobotSpec, start: Array, goal: Array, speed: float) -> float:
    """Duration [s] of a `Straight` motion at a share of the robot's largest velocities and accelerations."""
    away = np.abs(goal - start) / speed
    # A cubic's peak speed is 1.5 times its mean, and its first acceleration 6 times distance / duration².
    by_speed, by_force = 1.5 * away / robot.max_velocity, np.sqrt(6 * away / np.array(robot.max_acceleration))
    return float(np.maximum(by_speed, by_force).max())


def home_of(robot: RobotSpec, q: Array) -> Array:
    """Home configuration (1 + n,) of torso and arm, unwrapped to the turns of another configuration."""
    return np.asarray(unwrap_joints(robot_arrays(robot), q, np.array(robot.home)))


def planned_from(robot: RobotSpec, q: Array) -> Array:
    """Configuration (1 + n,) of torso and arm to plan from: exactly home if near home."""
    home = home_of(robot, q)
    return home if np.abs(q - home).max() <= _NEAR_HOME else q
