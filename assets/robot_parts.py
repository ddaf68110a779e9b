"""What a robot is made of: joints, arms, meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["AXES", "NO_TURN", "ArmSpec", "ChainLink", "InvalidRobot", "LinkMesh"]

NO_TURN = (1.0, 0.0, 0.0, 0.0)
"""The quaternion, wxyz, of frames that are parallel."""

AXES = {
    "x": (1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0),
    "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "-z": (0.0, 0.0, -1.0),
}
"""The axes that have names."""


def rotation_of(quaternion: ArrayLike) -> NDArray[np.float64]:
    """The rotation (3, 3) of a quaternion (4,), wxyz."""
    w, x, y, z = np.asarray(quaternion, dtype=float) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


class InvalidRobot(ValueError):
    """The fields of a `RobotSpec` are not those of a robot; the message names the field."""


class ChainLink(NamedTuple):
    """One joint of the chain torso → arm.

    `offset` [m] and `quaternion` (wxyz) are the joint frame's origin and orientation in its parent's frame while the
    joint is at zero; `axis` is "x", "y", "z", "-x", "-y", "-z" or a unit vector of the joint's frame; `prismatic`
    joints move along it.
    """

    joint: str
    offset: tuple[float, float, float]
    axis: str | tuple[float, float, float]
    lower: float
    upper: float
    prismatic: bool = False
    quaternion: tuple[float, float, float, float] = NO_TURN

    @property
    def direction(self) -> tuple[float, float, float]:
        """Unit vector of the axis in the joint's frame."""
        return AXES[self.axis] if isinstance(self.axis, str) else self.axis

    @property
    def rotation(self) -> NDArray[np.float64]:
        """(3, 3) orientation of the joint's frame in its parent's while the joint is at zero."""
        return rotation_of(self.quaternion)


class LinkMesh(NamedTuple):
    """A visual mesh of one body, used only when the `[visuals]` extra is installed."""

    body: str
    file: str
    rgba: tuple[float, float, float, float]
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class ArmSpec:
    """An arm with its gripper. The fields mean what those of the same names of `RobotSpec` mean, without the torso.

    `chain` has one link per arm joint, the first relative to the torso; `home`, `max_velocity` and `max_acceleration`
    are [rad], [rad/s] and [rad/s²] of its n joints. While another arm works, the arm stays in `home` with its gripper
    closed.
    """

    name: str
    chain: tuple[ChainLink, ...]
    tcp_offset: tuple[float, float, float]
    tcp_quaternion: tuple[float, float, float, float]
    tcp_site: str
    gripper_body: str
    finger_joints: tuple[str, str]
    finger_geoms: tuple[str, str]
    home: tuple[float, ...]
    max_velocity: tuple[float, ...]
    max_acceleration: tuple[float, ...]

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, shoulder first."""
        return tuple(link.joint for link in self.chain)
