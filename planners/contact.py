"""Contacts of a plan: gripper closing around an object, or opening to put it down, and labels for learners."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.motion.arm import tcp_pose
from planners.motion.trajectory import Trajectory
from planners.tamp.solution import BoundAction, Infeasible, Solution

Array = NDArray[np.float64]

_STRAIGHT = 1e-6
"""Deviation [m, rad] from the line ahead of the base that is due to rounding only."""


@dataclass(frozen=True, eq=False)
class Contact:
    """Poses of base and gripper when the gripper closes around an object or puts it down. Arrays are read-only.

    Attributes:
        skill: "pick" or "place".
        object: name of the object.
        base: (3,) x [m], y [m], yaw [rad] of the base at the contact, in the world.
        tcp: (4, 4) TCP pose at the contact, in the world [m].
    """

    skill: str
    object: str
    base: Array
    tcp: Array

    def __post_init__(self) -> None:
        for name in ("base", "tcp"):
            array = np.array(getattr(self, name), dtype=float)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def yaw(self) -> float:
        """Yaw [rad] of the gripper about the vertical, also defined for a gripper that points straight down."""
        return math.atan2(-self.tcp[0, 1], self.tcp[1, 1])

    @property
    def is_straight(self) -> bool:
        """Whether the base faces the gripper and both have the same yaw, as in a canonical plan if possible."""
        c, s = math.cos(self.base[2]), math.sin(self.base[2])
        away = self.tcp[:2, 3] - self.base[:2]
        aside, turn = c * away[1] - s * away[0], math.remainder(self.yaw - self.base[2], 2 * math.pi)
        return abs(aside) < _STRAIGHT and abs(turn) < _STRAIGHT


class StepLabel(NamedTuple):
    """Label of one control step of the expert.

    Attributes:
        phase: phase of the motion, as in `Trajectory.phases`: "drive", "ready", "transit", "approach", "close", "lift",
            "retreat", "lower", "open", "rise" and so on. "" while the robot waits or stops after a deviation.
        contact: the contact before or after this phase. None while the robot waits.
        keyframe: (12,) base x [m], y [m], yaw [rad], torso [m], arm [rad] and position of a finger [m] at the end of
            the phase.
    """

    phase: str
    contact: Contact | None
    keyframe: Array


def contacts(solution: Solution | Infeasible | None) -> tuple[Contact, ...]:
    """Contacts of a plan in order of time. Empty for a failure."""
    actions = solution.actions if isinstance(solution, Solution) else ()
    return tuple(contact for contact in map(contact_of, actions) if contact is not None)


def contact_of(action: BoundAction) -> Contact | None:
    """Contact of an action, None for a base motion."""
    if action.grip is None:
        return None
    state, _ = action.grip
    skill = "place" if action.is_put_down else "pick"
    return Contact(skill, action.target, state.base, tcp_pose(action.scene.robot, state))


def label_of(trajectory: Trajectory, time: float, contact: Contact | None) -> StepLabel:
    """Label of a step at a time [s] in a trajectory to or from a contact."""
    phase = trajectory.phase(time)
    later = (other.start for other in trajectory.phases if other.start > phase.start)
    end = trajectory.sample(next(later, trajectory.duration))
    return StepLabel(phase.name, contact, np.concatenate((end.base, end.q, [end.finger_position])))
