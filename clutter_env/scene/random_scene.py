"""Random scenes, a function of the random generator alone: sizes, places and masses of objects, start of the base."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import OptionError
from clutter_env.scene.layout import Layout
from clutter_env.scene.table_scene import TableScene

__all__ = ["MAX_OBJECTS", "SHAPE_SETS", "capacity", "sample_base", "sample_scene", "slot_shapes"]

RADIUS_RANGE = (0.025, 0.035)
"""[m] of a cylinder."""
HALF_WIDTH_RANGE = (0.020, 0.028)
"""[m] of a box; its corners then stay within the footprint of the larger cylinders' clearance."""
HEIGHT_RANGE = (0.12, 0.20)
"""[m]"""
MASS_RANGE = (0.15, 0.25)
"""[kg]"""
OBJECT_GAP = 0.012
"""[m] between the bounding circles of two objects at least."""
EDGE_MARGIN = 0.045
"""[m] from an object's axis to the table's edge at least."""

MAX_OBJECTS = 60
"""Objects in one scene at most, on any table: the planners' bit masks have no room for more."""

_PACKING = 0.46
"""Share of the area that random placement reliably fills; the limit is 0.547 (random sequential adsorption)."""
_BATCH = 128
_MAX_BATCHES = 200
_MAX_RESTARTS = 50

START_YAW = 0.5
"""[rad] either side of facing the table."""

SHAPE_SETS = ("cylinder", "box", "mixed")


def slot_shapes(shapes: str, count: int) -> tuple[str, ...]:
    """The shape of every slot of a random scene: a mixed set alternates."""
    if shapes == "mixed":
        return tuple("box" if index % 2 else "cylinder" for index in range(count))
    return (shapes,) * count


def capacity(layout: Layout, shapes: str) -> int:
    """How many objects of these shapes random placement reliably puts on the table."""
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
    low, high = layout.start_region
    return rng.uniform((*low, -START_YAW), (*high, START_YAW))


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
