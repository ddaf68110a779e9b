"""One scene: the objects on the table, the start of the robot, and the target."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class TableScene:
    """Objects, target and robot at the start of an episode. Arrays are read-only.

    Attributes:
        half_extents: (n, 3) [m]. For a cylinder: radius, radius, half height.
        is_box: (n,) whether each object is a box.
        positions: (n, 2) [m] on the table.
        yaws: (n,) [rad].
        masses: (n,) [kg].
        base: (3,) x [m], y [m], yaw [rad].
        target: slot of the target, -1 without one.
        is_lying: (n,) whether an object is a cylinder on its side, with its axis along its yaw.
        levels: (n,) [m] height above the table of the surface on which each object stands. The default is 0, the table
            itself.
        joints: (k, 2) dry friction and damping of the joints of drawers or the door, see `opening`. None by default.
    """

    half_extents: NDArray[np.float64]
    is_box: NDArray[np.bool_]
    positions: NDArray[np.float64]
    yaws: NDArray[np.float64]
    masses: NDArray[np.float64]
    base: NDArray[np.float64]
    target: int
    is_lying: NDArray[np.bool_]
    levels: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    joints: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        if not len(self.levels):
            object.__setattr__(self, "levels", np.zeros(len(self.yaws)))
        measures = (self.half_extents, self.positions, self.yaws, self.masses, self.base, self.levels, self.joints)
        for array in (*measures, self.is_box, self.is_lying):
            array.setflags(write=False)

    @property
    def num_objects(self) -> int:
        """Number of objects."""
        return len(self.yaws)

    @property
    def shapes(self) -> tuple[str, ...]:
        """The shape of each object, "box" or "cylinder"."""
        return tuple("box" if is_box else "cylinder" for is_box in self.is_box)

    @property
    def is_angular(self) -> NDArray[np.bool_]:
        """Whether the outline from above is a rectangle (n,). The other outlines are circles."""
        return self.is_box | self.is_lying

    @cached_property
    def standing_extents(self) -> NDArray[np.float64]:
        """Half extents (n, 3) [m] as the objects are placed: along their yaw, across it, and upwards."""
        return np.where(self.is_lying[:, None], self.half_extents[:, ::-1], self.half_extents)

    def with_target(self, index: int) -> TableScene:
        """The same scene with another target."""
        return replace(self, target=index)


def object_name(index: int) -> str:
    """Name of the object in this slot, in MuJoCo and everywhere else."""
    return f"object_{index:02d}"
