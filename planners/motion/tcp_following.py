"""Trajectories for robots that are told TCP poses: what the joints will do on the way, and what that hits."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.collision.world import CollisionWorld
from planners.motion.arm import tcp_pose
from planners.motion.trajectory import CONTROL_STEP, Trajectory
from planners.scene import HeldObject, RobotState

__all__ = ["ON_THE_WAY", "PATIENCE", "PRECISE", "Followed", "TcpFollower", "follow", "is_behind"]

Array = NDArray[np.float64]

PATIENCE = 60
"""Control steps at most that a hand is waited for at one sample."""
ON_THE_WAY, PRECISE = 0.03, 0.006
"""[m] that the hand may be behind, on free paths and where the fingers close or open; 5 times that in [rad]."""


class TcpFollower(Protocol):
    """A model of a controller that follows TCP poses in the base frame."""

    def reset(self, q: Array) -> None:
        """Start at rest in a configuration (8,)."""
        ...

    def step(self, T_base_tcp: Array) -> Array:
        """The configuration (8,) one control step later."""
        ...


@dataclass(frozen=True, eq=False)
class Followed:
    """How a trajectory is followed: whole-body configurations (n, 11), fingers (n,) [m], and the object in hand at each
    sample."""

    drive: Array
    finger_position: Array
    held: tuple[HeldObject | None, ...]

    @property
    def end(self) -> Array:
        """(8,) the last configuration."""
        return np.asarray(self.drive[-1, 3:])

    def hits(self, world: CollisionWorld, ignore: int) -> int:
        """What is hit on the way, as bits; `ignore` are bits that do not count."""
        found = 0
        gap = world.scene.robot.finger_gap_closed
        for stretch in self._segments():
            opening = gap + 2 * float(self.finger_position[stretch].max())
            found |= world.path_hits(self.drive[stretch], opening, self.held[stretch.start], ignore)
        return found

    def _segments(self) -> list[slice]:
        """Runs of samples with the same thing, or nothing, in hand, and the fingers still; moving, samples by pairs."""
        is_new_hold = np.array([now is not before for before, now in itertools.pairwise(self.held)], dtype=bool)
        moves = np.flatnonzero(np.diff(self.finger_position) != 0.0)
        bounds = sorted({0, len(self.held), *(np.flatnonzero(is_new_hold) + 1), *moves, *(moves + 1)})
        last = len(self.held) - 1
        return [
            slice(start, end + (end <= last and not is_new_hold[end - 1])) for start, end in itertools.pairwise(bounds)
        ]


class _Sample(NamedTuple):
    base: Array
    T_base_tcp: Array
    finger_position: float
    held: HeldObject | None
    precision: float


def is_behind(wanted: Array, actual: Array, precision: float) -> bool:
    """Whether a hand (4, 4) is farther than `precision` [m], or 5 times that in [rad], from where it should be."""
    distance = float(np.linalg.norm(wanted[:3, 3] - actual[:3, 3]))
    turn = float(np.linalg.norm(wanted[:3, :3] - actual[:3, :3])) / np.sqrt(2.0)
    return distance > precision or turn > 5 * precision


def follow(follower: TcpFollower, robot: RobotSpec, q_start: Array, trajectory: Trajectory) -> Followed | None:
    """How the joints follow a trajectory of which only the hand matters; None if the hand gets stuck.

    Args:
        follower: model of the controller.
        robot: who follows.
        q_start: (8,) configuration at the start.
        trajectory: what the hand is told; samples are waited for as `planners.execution.executor` does.
    """
    follower.reset(q_start)
    drive, fingers, held = [], [], []
    for sample in _samples(robot, trajectory):
        for waited in range(PATIENCE + 1):
            q = follower.step(sample.T_base_tcp)
            drive.append(np.concatenate((sample.base, q)))
            fingers.append(sample.finger_position)
            held.append(sample.held)
            hand = tcp_pose(robot, RobotState(np.zeros(3), q, 0.0))
            if not is_behind(sample.T_base_tcp, hand, sample.precision):
                break
            if waited == PATIENCE:
                return None
    return Followed(np.array(drive), np.array(fingers), tuple(held))


def _samples(robot: RobotSpec, trajectory: Trajectory) -> list[_Sample]:
    """What the hand is told at every control step."""
    contacts = [phase.start for phase in trajectory.phases if phase.name in ("close", "open")]
    found = []
    for time in trajectory.times:
        sample = trajectory.sample(float(time))
        is_contact = any(abs(time - start) <= CONTROL_STEP for start in contacts)
        hand = tcp_pose(robot, RobotState(np.zeros(3), sample.q, 0.0))
        precision = PRECISE if is_contact else ON_THE_WAY
        in_hand = sample.phase.touched if sample.phase.held else None
        found.append(_Sample(sample.base, hand, sample.finger_position, in_hand, precision))
    return found
