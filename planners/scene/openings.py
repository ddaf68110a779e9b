"""What opens: drawers, doors, lids and knobs, bodies on one slide or hinge.

What moves with an opening is among the static obstacles of a scene, where it is now; see `planners.scene.moving`.
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
"""[m] from the hinge up to which a handle turns in its place."""
_HANDLES = ("handle", "knob", "pull", "grip")
"""Words in the names of what is taken by the hand."""


class UnknownOpening(SceneError):
    """Nothing of that name opens; the message lists what does."""


@dataclass(frozen=True, eq=False)
class Opening:
    """A drawer, door, lid or knob: a body that moves on one slide or hinge.

    Attributes:
        name: of its body.
        kind: "slide" or "hinge".
        axis: (3,) unit vector in the world along which it slides, or about which it turns, where positions grow.
        point: (3,) [m] a point of the hinge.
        position: [m] or [rad] where it is.
        shut, open: [m] or [rad] the ends of its range: where it is closed, and as far open as it goes.
        parts: names of the static obstacles that move with it.
        handles: names of those of them that are taken by the hand, the likeliest first.
        friction: [N] or [N m] that it takes to move it.
        spring: [N] or [N m] with which a spring pulls it towards lower positions where it is open; less than zero
            towards higher ones.

    Raises:
        SceneError: a kind that is none, an axis without length, or numbers that are not finite.
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

    def __post_init__(self) -> None:
        axis = frozen(self.axis, (3,), f"axis of {self.name!r}")
        if self.kind not in ("slide", "hinge") or not np.linalg.norm(axis) > 0:
            raise SceneError(f"{self.name!r} moves on a {self.kind!r} along {axis}; known: slide, hinge, along an axis")
        object.__setattr__(self, "axis", frozen(axis / np.linalg.norm(axis), (3,), "axis"))
        object.__setattr__(self, "point", frozen(self.point, (3,), f"point of {self.name!r}"))
        for name in ("position", "shut", "open", "friction", "spring"):
            object.__setattr__(self, name, float(getattr(self, name)))
        if not all(math.isfinite(one) for one in (self.position, self.shut, self.open)):
            raise SceneError(f"{self.name!r} needs finite positions")
        for name in ("parts", "handles"):
            object.__setattr__(self, name, tuple(getattr(self, name)))

    @property
    def share(self) -> float:
        """How far it is open: 0 shut, 1 as far as it goes."""
        return (self.position - self.shut) / (self.open - self.shut) if self.open != self.shut else 0.0

    def at_share(self, share: float) -> float:
        """The position [m] or [rad] at which it is open by a share."""
        return self.shut + share * (self.open - self.shut)

    @property
    def springs_shut(self) -> bool:
        """Whether a spring shuts it when nobody holds it."""
        towards_shut = self.spring if self.open > self.shut else -self.spring
        return towards_shut > max(self.friction, 0.0)

    def motion(self, position: float) -> Array:
        """(4, 4) that takes points from where they are now to where they are with the opening at a position."""
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
        """Whether a point (3,) [m] is so near to the hinge that it turns in its place, as the middle of a knob."""
        away = point - self.point
        return self.kind == "hinge" and float(np.linalg.norm(away - (away @ self.axis) * self.axis)) < _KNOB

    def lever_arm(self, point: Array) -> float:
        """[m] of a point (3,) [m] from the hinge; infinite of what slides, which no lever moves more easily."""
        if self.kind == "slide":
            return math.inf
        away = point - self.point
        return float(np.linalg.norm(away - (away @ self.axis) * self.axis))

    def direction(self, point: Array) -> Array:
        """(3,) unit vector in which a point (3,) [m] of it moves when it is opened further; zero on the hinge."""
        sign = 1.0 if self.open >= self.shut else -1.0
        if self.kind == "slide":
            return sign * self.axis
        moved = sign * np.cross(self.axis, point - self.point)
        length = float(np.linalg.norm(moved))
        return moved / length if length > 1e-9 else np.zeros(3)


def is_handle_name(name: str) -> bool:
    """Whether something of that name is taken by the hand."""
    return any(word in name.lower() for word in _HANDLES)


@dataclass(frozen=True, eq=False)
class Pull:
    """A handle that stands among the objects of a scene: taken by the hand, it moves what opens, and is not lifted.

    It may be any part that closed fingers push.

    Attributes:
        handle: name of the object that stands for it.
        opening: name of what opens.
        position: [m] or [rad] to which it is to be moved.
        swept: where nothing may be put meanwhile.
        pushes: whether closed fingers push it, in place of a grasp.
        lever: name of what opens on it and is turned first by the same hand, which holds it meanwhile; "" for none.
        turned: [m] or [rad] to which that is turned.
    """

    handle: str
    opening: str
    position: float
    swept: tuple[Region, ...] = ()
    pushes: bool = False
    lever: str = ""
    turned: float = 0.0
