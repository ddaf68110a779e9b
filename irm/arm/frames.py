"""The joint frames of a robot as rows for kernels."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets.frames import frame_along, rotation_of
from assets.robots import ChainLink, RobotSpec

__all__ = ["PRISMATIC", "frames_of", "pose_of"]

Floats = NDArray[np.float64]

PRISMATIC = 3
"""Added to the axis number (x 0, y 1, z 2) of a joint that slides along its axis."""


def pose_of(place: Floats) -> Floats:
    """The pose (4, 4) of a row of `ArmChain`: an origin (3,), or with the nine entries of an orientation (12,)."""
    T = np.eye(4)
    T[:3, 3] = place[:3]
    if place.size > 3:
        T[:3, :3] = place[3:].reshape(3, 3)
    return T


def frames_of(robot: RobotSpec) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Offsets (1 + n, 3 or 12), axes (1 + n,) and tip (3,) or (12,) of a robot's chain, as in `ArmChain`.

    A joint about an axis of its own frame keeps that frame; any other is given one with z along its axis.
    """
    places, axes, before = [], [], np.eye(3)
    for link in robot.chain:
        number, own = _axis_and_frame(link)
        places.append(_place(before, link.offset, rotation_of(link.quaternion) @ own))
        axes.append(number + (PRISMATIC if link.prismatic else 0))
        before = own
    places.append(_place(before, robot.tcp_offset, rotation_of(robot.tcp_quaternion)))
    rows = np.array(places)
    if np.array_equal(rows[:, 3:], np.tile(np.eye(3).ravel(), (len(rows), 1))):
        rows = rows[:, :3]
    return rows[:-1].copy(), np.array(axes, dtype=np.int64), rows[-1].copy()


def _axis_and_frame(link: ChainLink) -> tuple[int, Floats]:
    """Number of a joint's axis, and the orientation (3, 3) in its frame of one that has this axis."""
    direction = np.array(link.direction)
    for number, axis in enumerate(np.eye(3)):
        if np.array_equal(direction, axis):
            return number, np.eye(3)
    return 2, frame_along(direction / np.linalg.norm(direction))


def _place(before: Floats, offset: ArrayLike, R: Floats) -> Floats:
    """(12,) origin and orientation, row by row, of a frame whose parent was turned by `before` (3, 3)."""
    return np.concatenate([before.T @ np.asarray(offset, dtype=float), (before.T @ R).ravel()])
