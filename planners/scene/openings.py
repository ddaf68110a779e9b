"""Openings: drawers, doors, lids and knobs, which are bodies on one slide or hinge.

The moving parts of an opening are static obstacles of a scene, at their present poses. See `planners.scene.moving`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from planners.regions import Region
from planners.scene.solid import SceneError, frozen

Array = NDArray[np.float64]
JointKind: TypeAlias = Literal["slide", "hinge"]

_KNOB = 0.02
"""[m] Largest distance from the hinge of a handle that turns in place."""
_HANDLES = ("handle", "knob", "pull", "grip")
"""Words in the names of handles."""


class UnknownOpening(SceneError):
    """No opening of that name. The message lists the openings."""


@dataclass(frozen=True, eq=False)
class Opening:
    """A drawer, door, lid or knob: a body that moves on one slide or hinge.

    Attributes:
        name: name of its body.
        kind: "slide" or "hinge".
        axis: (3,) unit vector in the world along which it slides, or about which it turns, towards higher positions.
        point: (3,) a point of the hinge [m].
        position: present position [m] or [rad].
        shut, open: ends of its range, closed and fully open [m] or [rad].
        parts: names of the static obstacles that move with it.
        handles: names of the parts to grasp, the likeliest first.
        friction: least force [N] or torque [N m] that moves it.
        spring: force [N] or torque [N m] of a spring and of its weight towards lower positions, half open. Negative
            towards higher positions.
        stiffness: stiffness of the spring [N/m] or [N m/rad].
        relaxed: position [m] or [rad] at which the spring exerts no force.

    Raises:
        SceneError: an unknown kind, an axis of length zero, or numbers that are not finite.
    """

    name: str
    kind: JointKind
    axis: Array
    point: Array
    position: float
    shut: float
    open: float
    parts: tuple[str, ...]
    handles: tuple[str, ...] = ()
    friction: float = 0.0
    spring: float = 0.0
    stiffness: float = 0.0
    relaxed: float = 0.0

    def __post_init__(self) -> None:
        axis = frozen(self.axis, (3,), f"axis of {self.name!r}")
        if self.kind not in ("slide", "hinge") or not np.linalg.norm(axis) > 0:
            raise SceneError(f"{self.name!r} moves on a {self.kind!r} along {axis}; known: slide, hinge, along an axis")
        object.__setattr__(self, "axis", frozen(axis / np.linalg.norm(axis), (3,), "axis"))
        object.__setattr__(self, "point", frozen(self.point, (3,), f"point of {self.name!r}"))
        for name in ("position", "shut", "open", "friction", "spring", "stiffness", "relaxed"):
            object.__setattr__(self, name, float(getattr(self, name)))
        if not all(math.isfinite(one) for one in (self.position, self.shut, self.open)):
            raise SceneError(f"{self.name!r} needs finite positions")
        for name in ("parts", "handles"):
            object.__setattr__(self, name, tuple(getattr(self, name)))

    @property
    def share(self) -> float:
        """Opened share: 0 shut, 1 fully open."""
        return (self.position - self.shut) / (self.open - self.shut) if self.open != self.shut else 0.0

    def at_share(self, share: float) -> float:
        """Position of an opened share [m] or [rad]."""
        return self.shut + share * (self.open - self.shut)

    @property
    def springs_shut(self) -> bool:
        """Whether a spring or its weight moves it towards shut when it is released half open."""
        half_open = self.at_share(0.5)
        return (half_open - self.released(half_open)) * (self.open - self.shut) > 0

    def opens_to(self, position: float) -> bool:
        """Whether a position [m] or [rad] is farther open than the present one."""
        return (position - self.position) * (self.open - self.shut) > 0

    def released(self, position: float) -> float:
        """Position [m] or [rad] to which a spring or its weight takes it from another one, where nobody holds it.

        The weight only counts where it shuts: in a lid that leans back when it is open, it does not open the shut lid.
        """
        stretched = self.stiffness * (self.at_share(0.5) - self.relaxed)
        sign, friction = (1.0 if self.open >= self.shut else -1.0), max(self.friction, 0.0)
        weight = sign * max(sign * (self.spring - stretched), 0.0)
        force = self.stiffness * (position - self.relaxed) + weight
        if abs(force) <= friction:
            return position
        back = -math.copysign(math.inf, force)
        if self.stiffness > 0:  # to where friction holds it
            back = self.relaxed + (math.copysign(friction, force) - weight) / self.stiffness
        return min(max(back, min(self.shut, self.open)), max(self.shut, self.open))

    def motion(self, position: float) -> Array:
        """Transform (4, 4) of points from their present places to those with the opening at a position."""
        T, by = np.eye(4), position - self.position
        if self.kind == "slide":
            T[:3, 3] = by * self.axis
            return T
        x, y, z = self.axis
        cross = np.array([(0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)])
        T[:3, :3] = np.eye(3) + math.sin(by) * cross + (1 - math.cos(by)) * cross @ cross
        T[:3, 3] = self.point - T[:3, :3] @ self.point
        return T

    def is_about(self, point: Array) -> bool:
        """Whether a point (3,) [m] is so near to the hinge that it turns in place, such as the middle of a knob."""
        away = point - self.point
        return self.kind == "hinge" and float(np.linalg.norm(away - (away @ self.axis) * self.axis)) < _KNOB

    def lever_arm(self, point: Array) -> float:
        """Distance of a point (3,) from the hinge [m]. Infinite for a slide, where the point makes no difference."""
        if self.kind == "slide":
            return math.inf
        away = point - self.point
        return float(np.linalg.norm(away - (away @ self.axis) * self.axis))

    def direction(self, point: Array) -> Array:
        """Unit vector (3,) of the motion of a point (3,) [m] as it opens further. Zero on the hinge."""
        sign = 1.0 if self.open >= self.shut else -1.0
        if self.kind == "slide":
            return sign * self.axis
        moved = sign * np.cross(self.axis, point - self.point)
        length = float(np.linalg.norm(moved))
        return moved / length if length > 1e-9 else np.zeros(3)


def is_handle_name(name: str) -> bool:
    """Whether a name is that of a handle."""
    return any(word in name.lower() for word in _HANDLES)


@dataclass(frozen=True, eq=False)
class Pull:
    """Handle among the objects of a scene. It is grasped to move an opening, and is not lifted.

    It may also be any part that closed fingers push.

    Attributes:
        handle: name of the object that represents it.
        opening: name of the opening.
        position: goal position of the opening [m] or [rad].
        swept: regions where no object may be put during the pull.
        pushes: whether closed fingers push it, without a grasp.
        lever: name of an opening on it, such as a door handle, that the same hand turns first and holds during the
            pull. "" for none.
        turned: goal position of the lever [m] or [rad].
    """

    handle: str
    opening: str
    position: float
    swept: tuple[Region, ...] = ()
    pushes: bool = False
    lever: str = ""
    turned: float = 0.0
