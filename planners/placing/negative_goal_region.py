"""The Negative Goal Region, which cleared objects must stay out of, and the order in which locations are tried.

Lee & Kim 2019, section 3.3, eq. 1-3 and Figs. 8-10. A region is a boolean mask over square cells of the support plane,
so that it can be drawn as it is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from planners.placing.rasterise import cells_of_marks, free_discs, mark_boxes, mark_discs
from planners.scene import Body, Solid, StaticObstacle
from planners.scene.solid import LEVEL

Array: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]

CELL_SIZE = 0.005
"""Side of a cell [m]. A table of 1.0 × 0.7 m has 28,000 cells."""


@dataclass(frozen=True)
class SupportGrid:
    """Square cells over the support plane.

    Attributes:
        x0: smallest x of cell (0, 0) [m].
        y0: smallest y of cell (0, 0) [m].
        resolution: side of a cell [m].
        shape: cells along x and y: the shape of every mask.
        height: height of the plane [m].
    """

    x0: float
    y0: float
    resolution: float
    shape: tuple[int, int]
    height: float

    @classmethod
    def over(cls, support: StaticObstacle, resolution: float = CELL_SIZE) -> SupportGrid:
        """The smallest grid that covers the top face of a support."""
        cells = np.ceil((support.upper - support.lower)[:2] / resolution - 1e-9).astype(int)
        return cls(
            float(support.lower[0]), float(support.lower[1]), resolution, (int(cells[0]), int(cells[1])), support.top
        )

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """(x low, x high, y low, y high) [m], as drawing routines expect it."""
        size = np.array(self.shape) * self.resolution
        return self.x0, self.x0 + float(size[0]), self.y0, self.y0 + float(size[1])

    def centres(self, cells: tuple[slice, slice] = (slice(None), slice(None))) -> Array:
        """Centres of all cells, or of some rows and columns, shape (rows, columns, 2) [m]."""
        x = self.x0 + (np.arange(self.shape[0])[cells[0]] + 0.5) * self.resolution
        y = self.y0 + (np.arange(self.shape[1])[cells[1]] + 0.5) * self.resolution
        return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)

    def cells_about(self, points: Array) -> tuple[slice, slice]:
        """Rows and columns of the cells in and next to the rectangle around points (k, 2) [m]."""
        low = np.floor((points.min(axis=0) - (self.x0, self.y0)) / self.resolution).astype(int) - 1
        high = np.ceil((points.max(axis=0) - (self.x0, self.y0)) / self.resolution).astype(int) + 1
        rows, columns = (slice(max(a, 0), max(b, 0)) for a, b in zip(low.tolist(), high.tolist(), strict=True))
        return rows, columns

    def empty(self) -> Mask:
        """A mask with no cell set."""
        return np.zeros(self.shape, dtype=np.bool_)


def _rows(*shape: int) -> Array:
    return np.zeros((0, *shape))


@dataclass(frozen=True, eq=False)
class SweptVolume:
    """Swept volume of a motion: shapes that together cover the robot and its load along a path.

    Attributes:
        spheres: (k, 4) x, y, z, radius [m] in the world.
        cylinders: (c, 5) upright cylinders: x, y, radius, lowest and highest z [m].
        box_centres: (m, 3) [m].
        box_axes: (m, 3, 3), the axes of a box as columns.
        box_half_extents: (m, 3) [m].
    """

    spheres: Array = field(default_factory=lambda: _rows(4))
    cylinders: Array = field(default_factory=lambda: _rows(5))
    box_centres: Array = field(default_factory=lambda: _rows(3))
    box_axes: Array = field(default_factory=lambda: _rows(3, 3))
    box_half_extents: Array = field(default_factory=lambda: _rows(3))

    def __post_init__(self) -> None:
        for one in fields(self):
            getattr(self, one.name).setflags(write=False)


def join_volumes(volumes: Iterable[SweptVolume]) -> SweptVolume:
    """Union of swept volumes."""
    parts = [SweptVolume(), *volumes]
    return SweptVolume(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(SweptVolume)))


def swept_mask(grid: SupportGrid, volume: SweptVolume, height: float) -> Mask:
    """Cells where the volume is lower than `height` [m] above the plane: no object that tall may stand there.

    The mask is conservative: every touched cell is set.
    """
    marks = _new_marks(grid)
    z_low, z_high = grid.height, grid.height + height
    place = (grid.x0, grid.y0, grid.resolution)
    # The part of a sphere between the two heights projects to the disc of its section nearest to the centre.
    spheres = volume.spheres[_is_near(grid, volume.spheres[:, :3], volume.spheres[:, 3], z_high)]
    away = np.maximum(np.maximum(z_low - spheres[:, 2], spheres[:, 2] - z_high), 0.0)
    sections = np.column_stack((spheres[:, :2], np.sqrt(np.maximum(spheres[:, 3] ** 2 - away**2, 0.0))))
    mark_discs(marks, sections[away < spheres[:, 3]], *place)
    between = (volume.cylinders[:, 3] < z_high) & (volume.cylinders[:, 4] > z_low)
    mark_discs(marks, volume.cylinders[between, :3], *place)
    near = _is_near(grid, volume.box_centres, np.linalg.norm(volume.box_half_extents, axis=1), z_high)
    boxes = (column[near] for column in (volume.box_centres, volume.box_axes, volume.box_half_extents))
    mark_boxes(marks, *boxes, z_low, z_high, *place)
    cells: Mask = cells_of_marks(marks)
    return cells


def _is_near(grid: SupportGrid, centres: Array, radii: Array, z_high: float) -> Mask:
    """Whether balls with centres (k, 3) and radii (k,) [m] can reach the space over the grid below `z_high`: (k,)."""
    x_low, x_high, y_low, y_high = grid.extent
    x, y, z = centres.T
    near: Mask = (x + radii > x_low) & (x - radii < x_high) & (y + radii > y_low) & (y - radii < y_high)
    return near & (z - radii < z_high) & (z + radii > grid.height)


def footprint_mask(grid: SupportGrid, bodies: Iterable[Body], clearance: float = 0.0) -> Mask:
    """Cells under objects, grown by `clearance` [m]: discs for upright cylinders, oriented boxes for other pieces."""
    marks = _new_marks(grid)
    discs: list[tuple[float, float, float]] = []
    boxes: list[Body | Solid] = []
    for body in bodies:
        if body.shape == "cylinder" and body.is_upright:
            discs.append((body.position[0], body.position[1], body.radius + clearance))
        elif body.shape != "pieces":
            boxes.append(body)
        for piece in body.placed if body.shape == "pieces" else ():
            if piece.shape == "cylinder" and abs(piece.rotation[2, 2]) > 1 - LEVEL:
                discs.append((piece.position[0], piece.position[1], piece.half_extents[0] + clearance))
            else:
                boxes.append(piece)
    place = (grid.x0, grid.y0, grid.resolution)
    if discs:
        mark_discs(marks, np.array(discs), *place)
    if boxes:
        centres = np.array([body.position for body in boxes])
        axes = np.array([body.rotation for body in boxes])
        half_extents = np.array([body.half_extents for body in boxes]) + clearance
        mark_boxes(marks, centres, axes, half_extents, -np.inf, np.inf, *place)
    cells: Mask = cells_of_marks(marks)
    return cells


@dataclass(frozen=True, eq=False)
class NegativeGoalRegion:
    """Cells where cleared objects must not stand.

    Attributes:
        ngr1: swept volume of the target's pick (eq. 1). Dogar & Srinivasa use this one alone.
        ngr2: swept volume of the picks of obstacles still to clear (eq. 2).
    """

    ngr1: Mask
    ngr2: Mask

    @property
    def mask(self) -> Mask:
        """NGR1 + NGR2 (eq. 3)."""
        return self.ngr1 | self.ngr2


def negative_goal_region(
    grid: SupportGrid,
    height: float,
    target: SweptVolume,
    obstacles: Iterable[SweptVolume] = (),
) -> NegativeGoalRegion:
    """Compute equations 1-3: the volumes of robot and objects in later steps, projected onto the plane.

    Args:
        grid: cells of the support plane.
        height: height [m] of the object to put down. Volumes above it are ignored.
        target: Volume(robot, τ_tar) + Volume(target, v_tar). Empty without a target.
        obstacles: Volume(robot, τ_obs) + Volume(obstacle, v_obs) of each object still to clear, except the one to put
            down.
    """
    ngr1, ngr2 = swept_mask(grid, target, height), swept_mask(grid, join_volumes(obstacles), height)
    for mask in (ngr1, ngr2):
        mask.setflags(write=False)
    return NegativeGoalRegion(ngr1, ngr2)


def dilated(grid: SupportGrid, mask: Mask, radius: float) -> Mask:
    """Centres at which a disc of that radius [m] would touch the mask, for drawings. `is_free` makes the decisions.

    A cell is set if a disc centred anywhere in it could touch.
    """
    away = distance_transform_edt(~mask) if mask.any() else np.full(mask.shape, np.inf)
    return np.asarray(away * grid.resolution < radius + grid.resolution * 2**0.5)


def is_free(grid: SupportGrid, mask: Mask, locations: Array, radius: float) -> Mask:
    """Whether discs of that radius [m] at `locations` (n, 2) lie on the plane and touch no cell of the mask: (n,)."""
    free: Mask = free_discs(mask, np.ascontiguousarray(locations), radius, grid.x0, grid.y0, grid.resolution)
    return free


def clearance_order(locations: Array, in_work: Mask, reference_point: Array) -> NDArray[np.intp]:
    """Sort clearance locations into the order of their tries (section 3.3, Fig. 10).

    Locations of R_work ∩ R_plane come first, the farthest from the reference point first, so that nearer ones remain
    for later objects. Locations of R_plane - R_work follow, the nearest first. The base must drive for these.

    Args:
        locations: (n, 2) or (n, 3) placement locations [m] outside the Negative Goal Region.
        in_work: (n,) whether the arm can put the object there without driving: R_work.
        reference_point: (2,) [m] origin of the distances: the base, or the grasped object.

    Returns:
        indices of the locations (n,).
    """
    distance = np.linalg.norm(locations[:, :2] - reference_point, axis=1)
    return np.lexsort((np.where(in_work, -distance, distance), ~in_work))


def _new_marks(grid: SupportGrid) -> NDArray[np.int32]:
    return np.zeros((grid.shape[0], grid.shape[1] + 1), dtype=np.int32)
