"""Random scenes, a function of the random generator alone: sizes, places and masses of objects, start of the base."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import OptionError
from clutter_env.scene.layout import Layout
from clutter_env.scene.object_sets import OBJECT_GAP, OBJECT_SETS, ObjectSet, slot_shapes
from clutter_env.scene.table_scene import TableScene

__all__ = ["sample_base", "sample_scene"]

_BATCH = 128
_MAX_BATCHES = 200
_MAX_RESTARTS = 50

START_YAW = 0.5
"""[rad] either side of facing the table."""


def sample_scene(
    rng: np.random.Generator,
    layout: Layout,
    num_objects: int,
    shapes: str = "cylinder",
    objects: ObjectSet = OBJECT_SETS["standard"],
) -> TableScene:
    """Objects without overlap, a target among them, and a base pose in front of the table.

    Raises:
        OptionError: no placement was found; cannot happen up to `capacity`.
    """
    is_box = np.array([shape == "box" for shape in slot_shapes(shapes, num_objects)], dtype=bool)
    half_width = np.where(
        is_box, rng.uniform(*objects.half_width, num_objects), rng.uniform(*objects.radius, num_objects)
    )
    half_height = rng.uniform(*objects.heights_on(layout), num_objects) / 2
    half_depth = np.where(is_box, rng.uniform(*objects.half_depth, num_objects), half_width)
    radii = np.where(is_box, np.hypot(half_depth, half_width), half_width)
    return TableScene(
        half_extents=np.column_stack((half_depth, half_width, half_height)),
        is_box=is_box,
        positions=_place(rng, layout, radii, objects.edge_margin),
        yaws=np.where(is_box, rng.uniform(-math.pi, math.pi, num_objects), 0.0),
        masses=rng.uniform(*objects.mass, num_objects),
        base=sample_base(rng, layout),
        target=int(rng.integers(num_objects)) if num_objects else -1,
    )


def sample_base(rng: np.random.Generator, layout: Layout) -> NDArray[np.float64]:
    """A base pose (x, y, yaw) in front of the table, clear of the furniture."""
    low, high = layout.start_region
    return rng.uniform((*low, -START_YAW), (*high, START_YAW))


def _place(rng: np.random.Generator, layout: Layout, radii: NDArray[np.float64], margin: float) -> NDArray[np.float64]:
    """Positions (n, 2) of circles that keep `OBJECT_GAP` apart, uniform over what is free."""
    for _ in range(_MAX_RESTARTS):
        positions = _place_once(rng, layout, radii, margin)
        if positions is not None:
            return positions
    raise OptionError(f"no room for {len(radii)} objects on layout {layout.name!r}; ask for fewer")


def _place_once(
    rng: np.random.Generator, layout: Layout, radii: NDArray[np.float64], margin: float
) -> NDArray[np.float64] | None:
    """One attempt, object by object; None when the next object found no room."""
    high = np.array([layout.depth, layout.width]) / 2 - margin
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
