"""The cells of a reachability map: voxels of TCP positions times sampled TCP orientations."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, prod
from operator import index
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irm.arm.chain import ArmChain, has_free_roll
from irm.errors import ReachabilityError
from irm.maps.orientations import Orientations
from irm.maps.parameters import MapParameters

__all__ = ["MapGrid", "MapParameters", "Orientations", "has_free_roll"]

Floats = NDArray[np.float64]

_BYTES_PER_CELL = 10
"""Memory that building takes for each cell of the grid: μ, torso height, flags, and two masks."""

MAX_BYTES = 6 * 2**30
"""Memory that building a map may take. A finer map would take hours to build, and its cells have 32-bit numbers."""


@dataclass(frozen=True, eq=False)
class MapGrid:
    """Voxels and orientations of one map, and the torso heights that were tried.

    Cells are numbered by (z, orientation, x, y), the last one fastest, so that the cells of one layer and one group
    (pitch, roll) are consecutive. The x, y grid is centred on the axis of the arm's first joint.

    Attributes:
        voxel: [m] edge of the cells along x and y.
        thickness: [m] of a layer: the voxel's edge, or a little less, so that torso heights one layer apart include
            both ends of the lift.
        centre: (2,) x, y of the grid's centre in the base frame [m].
        half: cells from the centre to the edge; the grid is (2 half, 2 half).
        bottom: [m] lower face of the lowest layer.
        layers: number of layers.
        torsos: (t,) torso heights, `thickness` apart [m].
        torso_range: lowest and highest torso height of the map's configurations [m]; equal for a fixed torso.
        orientations: of the TCP.
        cut_below, cut_above: whether the parameters' heights, not the floor or the arm's reach, end the grid there.
    """

    voxel: float
    thickness: float
    centre: tuple[float, float]
    half: int
    bottom: float
    layers: int
    torsos: tuple[float, ...]
    torso_range: tuple[float, float]
    orientations: Orientations
    cut_below: bool
    cut_above: bool

    @staticmethod
    def of(chain: ArmChain, parameters: MapParameters) -> MapGrid:
        """The grid of all cells that the arm may reach within the heights of the parameters."""
        voxel = parameters.voxel
        thickness, torsos = _torso_samples(chain, parameters)
        reach, shoulder = chain.reach, chain.shoulder
        floor = max(0.0, float(shoulder[2] + torsos[0] - reach))
        ceiling = float(shoulder[2] + torsos[-1] + reach)
        lowest = int(np.floor(max(parameters.heights[0], floor) / thickness + 1e-9))
        highest = int(np.ceil(min(parameters.heights[1], ceiling) / thickness - 1e-9))
        if highest <= lowest:
            raise ReachabilityError(f"{chain.robot} reaches nothing at heights {parameters.heights} m")
        grid = MapGrid(
            voxel=voxel,
            thickness=thickness,
            centre=(float(shoulder[0]), float(shoulder[1])),
            half=int(np.ceil(reach / voxel)),
            bottom=lowest * thickness,
            layers=highest - lowest,
            torsos=torsos,
            torso_range=(float(chain.lower[0]), float(chain.upper[0])) if parameters.lift else (torsos[0], torsos[0]),
            orientations=Orientations.sample(parameters, has_free_roll(chain)),
            cut_below=parameters.heights[0] > floor,
            cut_above=parameters.heights[1] < ceiling,
        )
        return grid.checked()

    @staticmethod
    def around(positions: Floats, parameters: MapParameters) -> MapGrid:
        """The grid around TCP positions (n, 3) that were computed elsewhere; the lowest ones are centres of cells."""
        voxel, low, high = parameters.voxel, positions.min(axis=0), positions.max(axis=0)
        cells = np.floor((high - low) / voxel + 0.5).astype(np.int64) + 1
        half = int(cells[:2].max() + 1) // 2
        x, y = (low[:2] + (half - 0.5) * voxel).tolist()
        extent = {"centre": [x, y], "half": half, "bottom": float(low[2] - voxel / 2), "layers": int(cells[2])}
        return MapGrid.of_extent(parameters, extent)

    @staticmethod
    def of_extent(parameters: MapParameters, extent: Any) -> MapGrid:
        """The grid with the extent that `extent()` returned, for a map without an arm.

        Raises:
            ReachabilityError: it is no such extent.
        """
        try:
            x, y = (float(value) for value in extent["centre"])
            half, layers, bottom = index(extent["half"]), index(extent["layers"]), float(extent["bottom"])
        except (TypeError, ValueError, KeyError, OverflowError) as problem:
            raise ReachabilityError(f"{str(extent)[:100]} is no extent of a grid") from problem
        if not (np.isfinite((x, y, bottom)).all() and half > 0 and layers > 0):
            raise ReachabilityError(f"{extent} is no extent of a grid")
        grid = MapGrid(
            voxel=parameters.voxel,
            thickness=parameters.voxel,
            centre=(x, y),
            half=half,
            bottom=bottom,
            layers=layers,
            torsos=(0.0,),
            torso_range=(0.0, 0.0),
            orientations=Orientations.sample(parameters, parameters.rolls <= 1),
            cut_below=True,
            cut_above=True,
        )
        return grid.checked()

    def extent(self) -> dict[str, Any]:
        """What does not follow from the parameters alone, for `of_extent`."""
        return {"centre": list(self.centre), "half": self.half, "bottom": self.bottom, "layers": self.layers}

    def checked(self) -> MapGrid:
        """The grid itself.

        Raises:
            ReachabilityError: it has more cells than memory should hold; the message gives its size.
        """
        if self.size * _BYTES_PER_CELL > MAX_BYTES:
            raise ReachabilityError(
                f"this map has {self.size:.3g} cells and needs {self.size * _BYTES_PER_CELL / 2**30:.3g} GiB; at most "
                f"{MAX_BYTES / 2**30:.0f} GiB are allowed: take larger voxels, fewer orientations, or some pitches and "
                "heights only"
            )
        return self

    @property
    def top(self) -> float:
        """[m] upper face of the highest layer."""
        return self.bottom + self.layers * self.thickness

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """(z, orientation, x, y)."""
        return self.layers, self.orientations.size, 2 * self.half, 2 * self.half

    @property
    def size(self) -> int:
        """Number of cells."""
        return prod(self.shape)

    def layer(self, z: float) -> int:
        """Index of the layer that contains a height [m]; may be outside the grid."""
        return floor((z - self.bottom) / self.thickness)

    def layer_height(self, layer: int) -> float:
        """[m] of a layer's middle."""
        return self.bottom + (layer + 0.5) * self.thickness

    def axis(self, side: int) -> Floats:
        """(2 half,) cell centres along x (side 0) or y (side 1) in the base frame [m]."""
        return np.asarray(self.centre[side] + (np.arange(2 * self.half) + 0.5 - self.half) * self.voxel)

    def edges(self, side: int) -> Floats:
        """(2 half + 1,) borders of the cells along x (side 0) or y (side 1) in the base frame [m]."""
        return np.asarray(self.centre[side] + np.arange(-self.half, self.half + 1) * self.voxel)

    def z_edges(self) -> Floats:
        """(layers + 1,) borders of the layers [m]."""
        return np.asarray(self.bottom + np.arange(self.layers + 1) * self.thickness)


def _torso_samples(chain: ArmChain, parameters: MapParameters) -> tuple[float, tuple[float, ...]]:
    """Thickness of a layer, at most the voxel's edge, and torso heights that far apart.

    They include both ends of the lift, but for the margin of the parameters. A lift by one sample moves the map of a
    fixed torso by one layer.
    """
    lower, upper = float(chain.lower[0]), float(chain.upper[0])
    if not parameters.lift:
        return parameters.voxel, (float(np.clip(chain.home_torso, lower, upper)),)
    margin = min(parameters.torso_margin, (upper - lower) / 2)
    lower, upper = lower + margin, upper - margin
    steps = int(np.ceil((upper - lower) / parameters.voxel - 1e-9))
    thickness = (upper - lower) / steps if steps else parameters.voxel
    return thickness, (*(lower + k * thickness for k in range(steps)), upper)
