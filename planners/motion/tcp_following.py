"""Trajectories for end-effector-controlled robots: the motion of the joints, and their collisions."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.collision.world import CollisionWorld
from planners.motion.arm import tcp_pose
from planners.motion.trajectory import CONTROL_STEP, Trajectory, is_contact
from planners.scene import HeldObject, RobotState

Array = NDArray[np.float64]

PATIENCE = 60
"""Most control steps that the next sample waits for the TCP."""
ON_THE_WAY, PRECISE = 0.03, 0.006
"""Lag [m] allowed for the TCP, on free paths and where the fingers close or open."""
RAD_PER_METRE = 5.0
"""Lag allowed for the orientation, per metre of lag [rad/m]."""


class TcpFollower(Protocol):
    """A model of a controller that follows TCP poses in the base frame.

    It may have a `line_tolerance` as in `planners.ControlledWorld`: the lag [m] that is allowed for the TCP near
    objects.
    """

    def reset(self, q: Array) -> None:
        """Start at rest in a configuration (8,)."""
        ...

    def step(self, T_base_tcp: Array) -> Array:
        """Configuration (8,) one control step later."""
        ...


@dataclass(frozen=True, eq=False)
class Followed:
    """Motion of the joints that follow a trajectory, sample by sample.

    Attributes:
        configurations: (n, 11) whole-body configurations.
        finger_position: (n,) position [m] of one finger.
        held: the held object, if any, at each of the n samples.
    """

    configurations: Array
    finger_position: Array
    held: tuple[HeldObject | None, ...]

    def hits(self, world: CollisionWorld, ignore: int) -> int:
        """Collision mask of the motion, without the bits of `ignore`."""
        found = 0
        # Runs of samples have the same held object and still fingers. Where fingers move, pairs of samples are checked.
        is_new_hold = np.array([now is not before for before, now in itertools.pairwise(self.held)], dtype=bool)
        moves = np.flatnonzero(np.diff(self.finger_position) != 0.0)
        bounds = sorted({0, len(self.held), *(np.flatnonzero(is_new_hold) + 1), *moves, *(moves + 1)})
        last = len(self.held) - 1
        for start, end in itertools.pairwise(bounds):
            rows = slice(start, end + (end <= last and not is_new_hold[end - 1]))
            opening = world.scene.robot.opening(float(self.finger_position[rows].max()))
            found |= world.path_hits(self.configurations[rows], opening, self.held[start], ignore)
        return found


def is_behind(wanted: Array, actual: Array, precision: float) -> bool:
    """Whether two TCP poses (4, 4) are more than `precision` [m] apart, or `RAD_PER_METRE` times that [rad]."""
    distance = float(np.linalg.norm(wanted[:3, 3] - actual[:3, 3]))
    turn = float(np.linalg.norm(wanted[:3, :3] - actual[:3, :3])) / np.sqrt(2.0)
    return distance > precision or turn > RAD_PER_METRE * precision


def allowed(trajectory: Trajectory, time: float, beside: float, near: float = CONTROL_STEP) -> float:
    """Lag [m] allowed for the TCP: `PRECISE` within `near` [s] of a contact, `beside` on lines there, or
    `ON_THE_WAY`."""
    phases = trajectory.phases
    contacts = [number for number, phase in enumerate(phases) if is_contact(phase)]
    if any(phases[number].start - near <= time <= phases[number].start + near for number in contacts):
        return PRECISE
    at = phases.index(trajectory.phase(time))
    return beside if any(abs(at - number) <= 1 for number in contacts) else ON_THE_WAY


def follow(follower: TcpFollower, robot: RobotSpec, q_start: Array, trajectory: Trajectory) -> Followed | None:
    """Simulate how the joints follow the TCP poses of a trajectory. None if the TCP lags for too long.

    Args:
        follower: model of the controller.
        robot: the robot of this controller.
        q_start: (8,) configuration at the start.
        trajectory: the commanded TCP poses. Each sample waits for the TCP as in `planners.expert.executor`.
    """
    beside = float(getattr(follower, "line_tolerance", ON_THE_WAY))
    follower.reset(q_start)
    configurations, fingers, held = [], [], []
    for time in trajectory.times:
        sample = trajectory.sample(float(time))
        wanted = tcp_pose(robot, RobotState(np.zeros(3), sample.q, 0.0))
        precision = allowed(trajectory, float(time), beside)
        for waited in range(PATIENCE + 1):
            q = follower.step(wanted)
            configurations.append(np.concatenate((sample.base, q)))
            fingers.append(sample.finger_position)
            held.append(sample.phase.touched if sample.phase.held else None)
            actual = tcp_pose(robot, RobotState(np.zeros(3), q, 0.0))
            if not is_behind(wanted, actual, precision):
                break
            if waited == PATIENCE:
                return None
    return Followed(np.array(configurations), np.array(fingers), tuple(held))
