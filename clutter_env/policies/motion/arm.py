"""The robot's arm: forward kinematics in torch, configurations that are the same for the gripper, its surface."""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
import torch
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.policies.parsed_observation import wrapped
from irm import PRISMATIC, frames_of, pose_of
from planners import robot_arrays

Array = NDArray[np.float64]

_POINT_SPACING = 0.02
"""[m] between points on the gripper's surface, at most."""
_AXES = torch.eye(3)
_ABOUT = tuple(
    (torch.outer(axis, axis), torch.diag(1 - axis), torch.linalg.cross(axis.expand(3, 3), _AXES).T) for axis in _AXES
)
"""The entries (3, 3) of a rotation about each axis that are fixed, and that its angle's cosine and sine multiply."""


class ArmKinematics:
    """Forward kinematics of torso and arm in torch, in the base's frame, for losses on the gripper's error."""

    def __init__(self, robot: RobotSpec) -> None:
        offsets, axes, tip = frames_of(robot)
        self._chain = tuple(
            (*_place(place), int(axis) % PRISMATIC, bool(axis >= PRISMATIC))
            for place, axis in zip(offsets, axes, strict=True)
        )
        self._tip, self._tip_turn = _place(tip)

    def tcp(self, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Positions (k, 3) [m] and orientations (k, 3, 3) of the TCP at configurations (k, 8)."""
        origins, rotations = self.links(q)
        return origins[:, -1], rotations[:, -1]

    def links(self, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Origins (k, 9, 3) [m] and orientations (k, 9, 3, 3) of the links behind all joints, and of the TCP."""
        R = torch.eye(3).expand(len(q), 3, 3)
        p, origins, rotations = torch.zeros(len(q), 3), [], []
        for joint, (offset, turn, axis, prismatic) in enumerate(self._chain):
            p = p + R @ offset
            R = R if turn is None else R @ turn
            if prismatic:
                p = p + R[:, :, axis] * q[:, joint, None]
            else:
                R = R @ rotations_about(axis, q[:, joint])
            origins.append(p)
            rotations.append(R)
        p = p + R @ self._tip
        R = R if self._tip_turn is None else R @ self._tip_turn
        return torch.stack((*origins, p), dim=1), torch.stack((*rotations, R), dim=1)


def _place(place: NDArray[np.float64]) -> tuple[torch.Tensor, torch.Tensor | None]:
    """Offset (3,) and orientation (3, 3) of a row of `frames_of`. The orientation is None if the row has none."""
    numbers = torch.tensor(place, dtype=torch.float32)
    return numbers[:3], numbers[3:].reshape(3, 3) if len(place) > 3 else None


def rotations_about(axis: int, angle: torch.Tensor) -> torch.Tensor:
    """Rotations (k, 3, 3) by angles (k,) about a coordinate axis."""
    fixed, of_cosine, of_sine = _ABOUT[axis]
    return fixed + torch.cos(angle)[:, None, None] * of_cosine + torch.sin(angle)[:, None, None] * of_sine


def with_wrist_flipped(robot: RobotSpec, q: Array) -> Array:
    """Configurations (..., 8) with the same gripper pose, the wrist bent to the other side, the forearm half a turn on.

    A robot whose arm does not end in a roll, a bend and a roll about one line keeps its configurations.
    """
    turned = np.array(q)
    for first in rolls_and_bends(robot)[-1:]:
        turned[..., first + 1] *= -1.0
        turned[..., (first, first + 2)] += np.pi
    return turned


def nearest_home(robot: RobotSpec, q: Array) -> Array:
    """Configurations (..., 8) with the same gripper pose, each in the one form that is nearest to home.

    Joints that turn without end are brought within half a turn of home. Where three joints in a row roll, bend and roll
    about one line, as Fetch's elbow and wrist do, both rolls by half a turn and the opposite bend are the same for all
    that follows: the bend gets the sign that it has at home.
    """
    home, turned = np.array(robot.in_front), np.array(q)
    for first in rolls_and_bends(robot):
        bend = turned[..., first + 1]
        is_flipped = bend * np.sign(home[first + 1]) < 0
        turned[..., first + 1] = np.where(is_flipped, -bend, bend)
        for roll in (first, first + 2):
            turned[..., roll] += np.where(is_flipped, np.pi, 0.0)
    endless = endless_joints(robot)[0]
    turned[..., endless] = home[endless] + wrapped(turned[..., endless] - home[endless])
    return turned


def is_wrist_flipped(robot: RobotSpec, q: Array) -> bool:
    """Whether the wrist is bent to the other side than at home, in a configuration (8,)."""
    return any(q[first + 1] * robot.home[first + 1] < 0 for first in rolls_and_bends(robot)[-1:])


def shorter_turns(robot: RobotSpec, q: Array, goals: Array) -> Array:
    """Goals (..., 8) whose joints with a range above one turn move along the shorter path from a configuration (8,).

    If that path leads beyond a limit of the joint, the longer path is taken.
    """
    endless, lower, upper = endless_joints(robot)
    turned = np.array(goals)
    near = q[endless] + wrapped(turned[..., endless] - q[endless])
    turned[..., endless] = near - 2 * np.pi * (near > upper) + 2 * np.pi * (near < lower)
    return turned


@cache
def rolls_and_bends(robot: RobotSpec) -> tuple[int, ...]:
    """Numbers of the first of three joints that roll, bend and roll about one line."""
    chain = robot.chain

    def is_one(first: int) -> bool:
        """Whether the three joints from this one on are such."""
        roll, bend, second = chain[first : first + 3]
        in_line = not any(bend.offset[1:]) and not any(second.offset[1:])
        is_symmetric = bend.lower == -bend.upper
        return (roll.axis, bend.axis, second.axis) == ("x", "y", "x") and in_line and is_symmetric

    return tuple(first for first in range(1, len(chain) - 2) if is_one(first))


@cache
def endless_joints(robot: RobotSpec) -> tuple[list[int], Array, Array]:
    """Numbers of the joints that turn by more than one turn, and their lower and upper limits [rad]."""
    numbers = [i for i, link in enumerate(robot.chain) if link.upper - link.lower > 2 * np.pi]
    lower, upper = np.array([(robot.chain[i].lower, robot.chain[i].upper) for i in numbers]).reshape(-1, 2).T
    return numbers, lower, upper


def gripper_points(robot: RobotSpec, finger: float) -> Array:
    """Points (n, 3) [m] on the boxes about palm, fingers and last wrist joint, in the TCP's frame.

    Args:
        robot: whose gripper it is.
        finger: [m] position of each finger.
    """
    arrays, found = robot_arrays(robot), []
    T = np.linalg.inv(pose_of(arrays.tip))
    for solid in range(arrays.held_from):
        half = arrays.half[solid] + arrays.radius[solid]
        steps = [np.linspace(-size, size, 1 + max(int(np.ceil(2 * size / _POINT_SPACING)), 1)) for size in half]
        grid = np.array(list(itertools.product(*steps)))
        surface = grid[np.isclose(np.abs(grid), half).any(axis=1)]
        found.append(arrays.position[solid] + surface @ arrays.rotation[solid].T + finger * arrays.slide[solid])
    return np.concatenate(found) @ T[:3, :3].T + T[:3, 3]
