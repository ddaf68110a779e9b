"""One scene: which objects stand where on the table, where the robot starts, which object is the target."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

__all__ = ["TableScene", "object_name"]


@dataclass(frozen=True, eq=False)
class TableScene:
    """What a reset puts into the world. Arrays are read-only.

    `half_extents` (n, 3) [m] (a cylinder: radius, radius, half height), `is_box` (n,), `positions` (n, 2) [m] on the
    table, `yaws` (n,) [rad], `masses` (n,) [kg], `base` (3,) x [m], y [m], yaw [rad], `target` an index.
    """

    half_extents: NDArray[np.float64]
    is_box: NDArray[np.bool_]
    positions: NDArray[np.float64]
    yaws: NDArray[np.float64]
    masses: NDArray[np.float64]
    base: NDArray[np.float64]
    target: int

    def __post_init__(self) -> None:
        for array in (self.half_extents, self.is_box, self.positions, self.yaws, self.masses, self.base):
            array.setflags(write=False)

    @property
    def num_objects(self) -> int:
        """How many objects there are."""
        return len(self.yaws)

    @property
    def shapes(self) -> tuple[str, ...]:
        """The shape of each object, "box" or "cylinder"."""
        return tuple("box" if is_box else "cylinder" for is_box in self.is_box)

    def with_target(self, index: int) -> TableScene:
        """The same scene with another target."""
        return replace(self, target=index)


def object_name(index: int) -> str:
    """Name of the object in this slot, in MuJoCo and everywhere else."""
    return f"object_{index:02d}"
