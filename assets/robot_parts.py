"""Parts of a robot (joints, arms, meshes), and the checks of its fields."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

NO_TURN = (1.0, 0.0, 0.0, 0.0)
"""Quaternion wxyz between parallel frames."""

AXES = {
    "x": (1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0),
    "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "-z": (0.0, 0.0, -1.0),
}
"""Axes by their names."""


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
    """A `RobotSpec` with an invalid field. The message names the field."""


class ChainLink(NamedTuple):
    """One joint of the chain torso → arm.

    `offset` [m] and `quaternion` (wxyz): origin and orientation of the joint frame in its parent's frame, with the
    joint at zero. `axis`: "x", "y", "z", "-x", "-y", "-z" or a unit vector of the joint's frame. `prismatic`: whether
    the joint moves along the axis.
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
    quaternion: tuple[float, float, float, float] = NO_TURN


@dataclass(frozen=True)
class ArmSpec:
    """An arm with its gripper. The fields have the meaning of those in `RobotSpec`, without the torso.

    `chain`: one link per arm joint, the first relative to the torso. `home`, `max_velocity`, `max_acceleration`: [rad],
    [rad/s] and [rad/s²] of its n joints. While another arm works, the arm stays in `home` with its gripper closed.
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


ARM_FIELDS = ("tcp_offset", "tcp_quaternion", "tcp_site", "gripper_body", "finger_joints", "finger_geoms")
"""Fields common to `RobotSpec` and `ArmSpec`."""

_UNIT = 1e-6
"""Tolerance of the length of a unit vector or quaternion."""

_AXIS = "'x', 'y' or 'z', one of these with a minus sign, or a unit vector"


def require(holds: bool, name: str, problem: str) -> None:
    """Raise `InvalidRobot` with the name of a field and its problem, unless a condition holds."""
    if not holds:
        raise InvalidRobot(f"RobotSpec: {name} {problem}")


def check_chain(chain: object) -> None:
    """Check that a chain is a prismatic torso lift and at least one revolute joint, each with an axis and a range."""
    is_chain = isinstance(chain, tuple) and len(chain) >= 2 and all(isinstance(link, ChainLink) for link in chain)
    require(is_chain, "chain", "must be a tuple of ChainLink: a prismatic torso lift, then revolute arm joints")
    assert isinstance(chain, tuple)
    for index, link in enumerate(chain):
        kind = "prismatic" if index == 0 else "revolute"
        require(link.prismatic == (index == 0), "chain", f"must have a {kind} joint as entry {index}: {link.joint!r}")
        is_named = isinstance(link.axis, str) and link.axis in AXES
        require(is_named or not isinstance(link.axis, str), "chain", f"{link.joint!r}: axis must be {_AXIS}")
        check_unit(f"chain, axis of {link.joint!r}", link.direction, 3)
        check_unit(f"chain, quaternion of {link.joint!r}", link.quaternion, 4)
        check_numbers(f"chain, offset of {link.joint!r}", link.offset, 3)
        check_numbers(f"chain, range of {link.joint!r}", (link.lower, link.upper), 2)
        is_range = link.lower < link.upper or (index == 0 and link.lower == link.upper)
        require(is_range, "chain", f"{link.joint!r}: lower must be below upper (equal for a robot without a lift)")


def check_names(name: str, value: object, count: int | None = None) -> None:
    """Check that a field is a tuple of different names, with `count` entries if given."""
    is_tuple = isinstance(value, tuple) and all(isinstance(entry, str) and entry for entry in value)
    require(is_tuple, name, f"must be a tuple of names, not {value!r}")
    assert isinstance(value, tuple)
    is_right = len(value) == len(set(value)) and count in (None, len(value))
    require(is_right, name, f"must be {'' if count is None else f'{count} '}different names, not {value!r}")


def check_numbers(name: str, value: object, count: int, positive: bool = False) -> None:
    """Check that a field is a tuple of `count` finite, or positive, numbers."""
    is_tuple = isinstance(value, tuple) and all(isinstance(entry, Real) for entry in value)
    require(is_tuple, name, f"must be a tuple of numbers, not {value!r}")
    assert isinstance(value, tuple)
    require(len(value) == count, name, f"must have {count} numbers, not {len(value)}")
    holds = all(math.isfinite(entry) and (entry > 0 or not positive) for entry in value)
    require(holds, name, f"must be {'positive' if positive else 'finite'}, not {value!r}")


def check_unit(name: str, value: object, count: int) -> None:
    """Check that a field is a unit vector or quaternion of `count` numbers."""
    check_numbers(name, value, count)
    assert isinstance(value, tuple)
    require(abs(math.hypot(*value) - 1.0) < _UNIT, name, f"must have length 1, not {value!r}")
