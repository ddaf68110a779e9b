"""Tables and what stands on them: random scenes as a function of the random generator alone.

World frame: origin on the floor under the table's centre, x from the robot towards the table, y left, z up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import OptionError

__all__ = [
    "LAYOUTS",
    "MAX_OBJECTS",
    "SHAPE_SETS",
    "TABLE_HEIGHT",
    "Box",
    "Layout",
    "TableScene",
    "capacity",
    "furniture",
    "object_name",
    "sample_base",
    "sample_scene",
    "slot_shapes",
]

TABLE_HEIGHT = 0.75
"""[m] of every table's top face above the floor."""

_TOP_THICKNESS = 0.04
_LEG_HALF_WIDTH = 0.025
_COUNTER_WIDTH = 0.6
_WALL_HEIGHT = 1.6
_WALL_THICKNESS = 0.05
_PANEL_THICKNESS = 0.02
"""All [m]."""

RADIUS_RANGE = (0.025, 0.035)
"""[m] of a cylinder."""
HALF_WIDTH_RANGE = (0.020, 0.028)
"""[m] of a box; its corners then stay within the footprint of the larger cylinders' clearance."""
HEIGHT_RANGE = (0.12, 0.20)
MASS_RANGE = (0.15, 0.25)
"""[kg]"""
OBJECT_GAP = 0.012
"""[m] between the bounding circles of two objects at least."""
EDGE_MARGIN = 0.045
"""[m] from an object's axis to the table's edge at least."""

MAX_OBJECTS = 60
"""Objects in one scene at most, whatever the table: what the planners' bit masks hold."""

_PACKING = 0.46
"""Share of the area that random placement is trusted to fill; it jams at 0.547 (random sequential adsorption)."""
_BATCH = 128
_MAX_BATCHES = 200
_MAX_RESTARTS = 50

START_DISTANCE = (0.6, 1.1)
"""[m] from the table's front edge to the base centre at the start."""
SHELF_START_DISTANCE = (0.95, 1.3)
"""[m]; farther away, because the carried gripper is about as high as the shelf board."""
START_YAW = 0.5
"""[rad] either side of facing the table."""
START_SIDE_MARGIN = 0.1
"""[m] from the table's side edges, inwards."""

SHAPE_SETS = ("cylinder", "box", "mixed")


class Box(NamedTuple):
    """An axis-aligned piece of furniture: centre and half extents, each (3,) [m]."""

    name: str
    position: tuple[float, float, float]
    half_extents: tuple[float, float, float]


@dataclass(frozen=True)
class Layout:
    """A table (depth along x, width along y [m]) and how it is enclosed."""

    name: str
    depth: float
    width: float
    is_front_only: bool = True
    """Counters beside it and a wall behind it."""
    board_height: float | None = None
    """[m] from the table top to the shelf board above it, None without a shelf."""


LAYOUTS: Mapping[str, Layout] = MappingProxyType(
    {
        "paper": Layout("paper", depth=0.7, width=1.0),
        "wide": Layout("wide", depth=0.8, width=1.2),
        "dense": Layout("dense", depth=0.6, width=0.8),
        "shelf": Layout("shelf", depth=0.7, width=1.0, board_height=0.40),
        "island": Layout("island", depth=0.8, width=1.2, is_front_only=False),
    }
)


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


def slot_shapes(shapes: str, count: int) -> tuple[str, ...]:
    """The shape of every slot of a random scene: a mixed set alternates."""
    if shapes == "mixed":
        return tuple("box" if index % 2 else "cylinder" for index in range(count))
    return (shapes,) * count


def furniture(layout: Layout) -> tuple[Box, ...]:
    """The boxes that stand on the floor or hang above the table; the names are relied on elsewhere."""
    x, y, top = layout.depth / 2, layout.width / 2, TABLE_HEIGHT
    leg = _LEG_HALF_WIDTH
    leg_z = (top - _TOP_THICKNESS) / 2
    boxes = [Box("table_top", (0.0, 0.0, top - _TOP_THICKNESS / 2), (x, y, _TOP_THICKNESS / 2))]
    corners = ((-1, -1), (-1, 1), (1, -1), (1, 1))
    boxes += [
        Box(f"table_leg_{i}", (sx * (x - leg), sy * (y - leg), leg_z), (leg, leg, leg_z))
        for i, (sx, sy) in enumerate(corners)
    ]
    if layout.is_front_only:
        side = _COUNTER_WIDTH / 2
        boxes += [
            Box("counter_left", (0.0, y + side, top / 2), (x, side, top / 2)),
            Box("counter_right", (0.0, -y - side, top / 2), (x, side, top / 2)),
            Box(
                "wall",
                (x + _WALL_THICKNESS / 2, 0.0, _WALL_HEIGHT / 2),
                (_WALL_THICKNESS / 2, y + _COUNTER_WIDTH, _WALL_HEIGHT / 2),
            ),
        ]
    if layout.board_height is not None:
        boxes += _shelf(x, y, layout.board_height)
    return tuple(boxes)


def _shelf(x: float, y: float, board_height: float) -> list[Box]:
    """Side panels just outside the table and a board across them."""
    panel = _PANEL_THICKNESS / 2
    z = TABLE_HEIGHT + board_height / 2
    return [
        Box("shelf_left", (0.0, y + panel, z), (x, panel, board_height / 2)),
        Box("shelf_right", (0.0, -y - panel, z), (x, panel, board_height / 2)),
        Box("shelf_board", (0.0, 0.0, TABLE_HEIGHT + board_height + panel), (x, y + 2 * panel, panel)),
    ]


def capacity(layout: Layout, shapes: str) -> int:
    """How many objects of this kind random placement can be trusted to put on the table."""
    diameter = {
        "cylinder": sum(RADIUS_RANGE),
        "box": math.sqrt(2) * sum(HALF_WIDTH_RANGE),
        "mixed": (sum(RADIUS_RANGE) + math.sqrt(2) * sum(HALF_WIDTH_RANGE)) / 2,
    }[shapes] + OBJECT_GAP
    overhang = diameter / 2 - EDGE_MARGIN
    area = (layout.depth + 2 * overhang) * (layout.width + 2 * overhang)
    return min(int(_PACKING * area / (math.pi / 4 * diameter**2)), MAX_OBJECTS)


def sample_scene(rng: np.random.Generator, layout: Layout, num_objects: int, shapes: str = "cylinder") -> TableScene:
    """Upright objects without overlap, a target among them, and a base pose in front of the table.

    Raises:
        OptionError: no placement was found; cannot happen up to `capacity`.
    """
    is_box = np.array([shape == "box" for shape in slot_shapes(shapes, num_objects)], dtype=bool)
    half_width = np.where(is_box, rng.uniform(*HALF_WIDTH_RANGE, num_objects), rng.uniform(*RADIUS_RANGE, num_objects))
    half_height = rng.uniform(*HEIGHT_RANGE, num_objects) / 2
    half_depth = np.where(is_box, rng.uniform(*HALF_WIDTH_RANGE, num_objects), half_width)
    return TableScene(
        half_extents=np.column_stack((half_depth, half_width, half_height)),
        is_box=is_box,
        positions=_place(rng, layout, np.where(is_box, np.hypot(half_depth, half_width), half_width)),
        yaws=np.where(is_box, rng.uniform(-math.pi, math.pi, num_objects), 0.0),
        masses=rng.uniform(*MASS_RANGE, num_objects),
        base=sample_base(rng, layout),
        target=int(rng.integers(num_objects)) if num_objects else -1,
    )


def sample_base(rng: np.random.Generator, layout: Layout) -> NDArray[np.float64]:
    """A base pose (x, y, yaw) in front of the table, clear of the furniture."""
    near, far = START_DISTANCE if layout.board_height is None else SHELF_START_DISTANCE
    side = layout.width / 2 - START_SIDE_MARGIN
    return rng.uniform((-layout.depth / 2 - far, -side, -START_YAW), (-layout.depth / 2 - near, side, START_YAW))


def _place(rng: np.random.Generator, layout: Layout, radii: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions (n, 2) of circles that keep `OBJECT_GAP` apart, uniform over what is free."""
    for _ in range(_MAX_RESTARTS):
        positions = _place_once(rng, layout, radii)
        if positions is not None:
            return positions
    raise OptionError(f"no room for {len(radii)} objects on layout {layout.name!r}; ask for fewer")


def _place_once(rng: np.random.Generator, layout: Layout, radii: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """One attempt, object by object; None when the next object found no room."""
    high = np.array([layout.depth, layout.width]) / 2 - EDGE_MARGIN
    positions = np.empty((len(radii), 2))
    for index, radius in enumerate(radii):
        placed, reach = positions[:index], radii[:index] + (radius + OBJECT_GAP)
        for _ in range(_MAX_BATCHES):
            candidates = rng.uniform(-high, high, (_BATCH if index > 10 else 8, 2))
            offset = candidates[:, None, :] - placed
            is_free = (offset[..., 0] ** 2 + offset[..., 1] ** 2 > reach**2).all(axis=1)
            first = int(is_free.argmax())
            if is_free[first]:
                positions[index] = candidates[first]
                break
        else:
            return None
    return positions
