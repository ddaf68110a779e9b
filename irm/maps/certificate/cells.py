"""The cells of a certificate table: wrist centres around the pan axis times approach axes relative to them.

Pan turns everything about a vertical axis, and the arm is symmetric about its plane. So a pose has four coordinates:
the distance of the wrist centre from the pan axis, its height above the lift axis with the torso at 0, the elevation of
the approach axis, and the yaw of that axis relative to the bearing of the wrist centre, without its sign. The roll of a
wrist that turns without limit does not count.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, cos, pi, radians, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.arm.chain import ArmChain
from irm.errors import ReachabilityError

__all__ = ["CellArrays", "CertificateCells", "TableParameters"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_EDGE_SAMPLES = 64
"""Points of an edge of a cell of approach axes of which the distance from its centre is computed."""


@dataclass(frozen=True)
class TableParameters:
    """Resolution of a certificate table.

    Attributes:
        width: largest size of a cell in distance and height of the wrist centre, 0.01 to 0.2 [m].
        step: largest size of a cell in elevation and yaw of the approach axis, 2 to 45 degrees [rad].

    Raises:
        ReachabilityError: a value is no number or out of its range.
    """

    width: float = 0.03
    step: float = radians(7.5)

    def __post_init__(self) -> None:
        try:
            width, step = float(self.width), float(self.step)
        except (TypeError, ValueError) as problem:
            raise ReachabilityError(f"width and step of a table are numbers: {self}") from problem
        object.__setattr__(self, "width", width)
        object.__setattr__(self, "step", step)
        if not (0.01 <= width <= 0.2 and radians(2) <= step <= radians(45)):
            raise ReachabilityError(f"width must be 0.01 to 0.2 m and step 2 to 45 degrees, given in radians: {self}")


class CellArrays(NamedTuple):
    """The cells as arrays and numbers for kernels; the names are those of `CertificateCells`."""

    width: float
    thickness: float
    bottom: float
    columns: int
    layers: int
    ring_first: Integers


@dataclass(frozen=True, eq=False)
class CertificateCells:
    """Cells numbered by (distance, height, approach axis), the last one fastest.

    Approach axes are grouped in rings of equal elevation. The cells of a ring divide the half turn of relative yaws.

    Attributes:
        width: of a cell in the distance of the wrist centre [m].
        thickness: of a cell in its height; the lift's range is a multiple of it [m].
        bottom: lowest height [m].
        columns, layers: number of cells in distance and height.
        ring_first: (rings + 1,) first cell of approach axes of each ring; the last one is their number.
    """

    width: float
    thickness: float
    bottom: float
    columns: int
    layers: int
    ring_first: Integers

    @staticmethod
    def of(chain: ArmChain, parameters: TableParameters) -> CertificateCells:
        """The cells of an arm.

        Raises:
            ReachabilityError: the arm has not the structure of Fetch's arm, or its pan joint turns less than half a
                turn.
        """
        if not chain.has_closed_form or chain.upper[1] - chain.lower[1] < pi:
            raise ReachabilityError(
                f"{chain.robot}: a certificate table needs an arm with the structure of Fetch's arm, whose pan joint "
                "has a range of at least half a turn"
            )
        width, step = parameters.width, parameters.step
        reach, lift = float(chain.links[4] + chain.links[5]), float(chain.upper[0] - chain.lower[0])
        farthest = float(chain.links[2]) + reach
        columns = ceil(farthest / width)
        thickness = lift / ceil(lift / width) if lift > 0.0 else width
        layers = ceil((lift + 2.0 * reach) / thickness)
        rings = ceil(pi / step)
        middles = (np.arange(rings) + 0.5) * (pi / rings) - pi / 2
        counts = np.ceil(rings * np.cos(middles)).astype(np.int64)
        ring_first = np.concatenate([[0], np.cumsum(counts)])
        ring_first.setflags(write=False)
        bottom = float(chain.lower[0]) - reach
        return CertificateCells(farthest / columns, thickness, bottom, columns, layers, ring_first)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(distance, height, approach axis)."""
        return self.columns, self.layers, int(self.ring_first[-1])

    @property
    def arrays(self) -> CellArrays:
        """The cells for kernels."""
        return CellArrays(self.width, self.thickness, self.bottom, self.columns, self.layers, self.ring_first)

    def approach_axes(self) -> Floats:
        """(m, 4) middle of each cell of approach axes, x along the bearing of the wrist centre, and the largest angle
        between it and an axis in the cell [rad]."""
        rings, rows = len(self.ring_first) - 1, []
        for ring in range(rings):
            count = int(self.ring_first[ring + 1] - self.ring_first[ring])
            low, high = ((ring + side) * pi / rings - pi / 2 for side in (0, 1))
            middle, half = 0.5 * (low + high), 0.5 * pi / count
            elevations = np.linspace(low, high, _EDGE_SAMPLES)
            cosines = cos(middle) * np.cos(elevations) * cos(half) + sin(middle) * np.sin(elevations)
            radius = float(np.arccos(np.clip(cosines, -1.0, 1.0)).max()) + (elevations[1] - elevations[0])
            for k in range(count):
                yaw = (k + 0.5) * pi / count
                rows.append((cos(middle) * cos(yaw), cos(middle) * sin(yaw), sin(middle), radius))
        return np.array(rows)
