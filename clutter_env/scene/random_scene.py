"""Random scenes: sizes, positions and masses of objects, and the start of the base. They depend on the random generator
alone.

In screened scenes the target stands behind a screen of other objects, as on a shelf that is filled from the back.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import OptionError
from clutter_env.scene.household import KINDS, HouseholdScene, slot_kinds
from clutter_env.scene.layout import OBJECT_GAP, Layout, openings_of
from clutter_env.scene.object_sets import OBJECT_SETS, ObjectSet, slot_shapes
from clutter_env.scene.opening import DAMPING_RANGE, FRICTION_RANGE, Surface
from clutter_env.scene.table_scene import TableScene

_FEW, _MANY = 8, 128
"""Candidates drawn at once for an object. The first `_EASY` objects need few, because most candidates are free. Of many
candidates, the first few are checked before the others."""
_EASY = 11
_MAX_BATCHES = 200
_MAX_RESTARTS = 50

MOST_IN_THE_WAY = 2
"""Most objects that block a drawer."""
START_YAW = 0.5
"""[rad] Largest deviation from facing the table, to either side."""


def sample_scene(
    rng: np.random.Generator,
    layout: Layout,
    num_objects: int,
    shapes: str = "cylinder",
    objects: ObjectSet = OBJECT_SETS["standard"],
) -> TableScene:
    """Sample objects without overlap, wholly on the table, a target among them, and a base pose in front of the table.

    Raises:
        OptionError: no placement was found. This cannot happen up to `capacity`.
    """
    if objects.kinds:
        kinds = [KINDS[name] for name in slot_kinds(num_objects)]
        half_extents = np.array([kind.half_extents for kind in kinds]).reshape(-1, 3)
        is_box, is_lying = np.ones(num_objects, dtype=bool), np.zeros(num_objects, dtype=bool)
        radii = np.hypot(half_extents[:, 0], half_extents[:, 1])
    else:
        is_box = np.array([shape == "box" for shape in slot_shapes(shapes, num_objects)], dtype=bool)
        is_lying = ~is_box & objects.are_cylinders_lying
        half_width = np.where(
            is_box, rng.uniform(*objects.half_width, num_objects), rng.uniform(*objects.radius, num_objects)
        )
        half_height = rng.uniform(*objects.heights_on(layout), num_objects) / 2
        half_depth = np.where(is_box | is_lying, rng.uniform(*objects.half_depth, num_objects), half_width)
        half_height = np.where(is_lying, half_width, half_height)
        radii = np.where(is_box | is_lying, np.hypot(half_depth, half_width), half_width)
        half_extents = np.column_stack((half_depth, half_width, half_height))
        half_extents = np.where(is_lying[:, None], half_extents[:, ::-1], half_extents)
    rows = _rows(rng, layout, num_objects)
    positions = np.zeros((num_objects, 2))
    for row, surface in enumerate(layout.surfaces):  # only objects on the same surface have to keep their distance
        here = np.flatnonzero(rows == row)
        if objects.kinds:
            here = here[np.argsort(-radii[here], kind="stable")]  # the widest first: they are the hardest to place
        margin = radii[here] if objects.kinds else objects.edge_margin
        positions[here] = _place(rng, layout, surface, radii[here], margin)
    return (HouseholdScene if objects.kinds else TableScene)(
        half_extents=half_extents,
        is_box=is_box,
        positions=positions,
        yaws=np.where(is_box | is_lying, rng.uniform(-math.pi, math.pi, num_objects), 0.0),
        masses=np.array([kind.mass for kind in kinds]) if objects.kinds else rng.uniform(*objects.mass, num_objects),
        base=sample_base(rng, layout),
        target=_target(rng, layout, rows),
        is_lying=is_lying,
        levels=np.array(layout.levels)[rows],
        joints=sample_joints(rng, layout),
    )


def sample_base(rng: np.random.Generator, layout: Layout) -> NDArray[np.float64]:
    """Sample a base pose (x, y, yaw) in front of the table, clear of the furniture."""
    (low_x, low_y), (high_x, high_y) = layout.start_region
    low, high = np.array(((low_x, low_y, -START_YAW), (high_x, high_y, START_YAW)))
    base: NDArray[np.float64] = low + (high - low) * rng.random(3)
    return base


def sample_joints(rng: np.random.Generator, layout: Layout) -> NDArray[np.float64]:
    """Sample dry friction and damping (k, 2) of the joints of drawers or the door, see `opening`.

    A layout without them has (0, 2), and nothing is drawn from `rng`.
    """
    if layout.opens is None:
        return np.zeros((0, 2))
    low, high = np.array((FRICTION_RANGE, DAMPING_RANGE)).T
    return np.asarray(rng.uniform(low, high, (len(openings_of(layout)), 2)))


def _rows(rng: np.random.Generator, layout: Layout, num_objects: int) -> NDArray[np.int64]:
    """Index (n,) of the surface on which each object stands: all surfaces in turn, or one or two objects in front of a
    drawer.

    Drawers side by side have equal numbers of objects, or one more. Neither an object's slot nor its shape tells its
    drawer.
    """
    if layout.opens == "drawers":
        return rng.permutation((np.arange(num_objects) + rng.integers(len(layout.surfaces))) % len(layout.surfaces))
    if not layout.front:
        return np.arange(num_objects) % len(layout.surfaces)
    rows = np.zeros(num_objects, dtype=np.int64)
    count = min(int(rng.integers(1, MOST_IN_THE_WAY + 1)), max(num_objects - 1, 0))
    rows[rng.permutation(num_objects)[:count]] = 1
    return rows


def _target(rng: np.random.Generator, layout: Layout, rows: NDArray[np.int64]) -> int:
    """Sample the target's slot, that of an object inside, or -1 without any. Each filled drawer is equally likely to
    hold it."""
    slots = np.flatnonzero(rows < len(layout.inside))
    if layout.opens == "drawers" and len(slots):
        filled = np.unique(rows)
        slots = np.flatnonzero(rows == filled[rng.integers(len(filled))])
    return int(slots[rng.integers(len(slots))]) if len(slots) else -1


def _place(
    rng: np.random.Generator,
    layout: Layout,
    surface: Surface,
    radii: NDArray[np.float64],
    margin: float | NDArray[np.float64],
) -> NDArray[np.float64]:
    """Sample positions (n, 2) of circles that keep the surface's gap apart, uniformly over the free area.

    `margin` [m], a number or (n,): distance of the circles' centres from the edges.
    """
    for _ in range(_MAX_RESTARTS):
        positions = _place_once(rng, surface, radii, margin)
        if positions is not None:
            return positions + surface.centre
    raise OptionError(f"no space for {len(radii)} objects on layout {layout.name!r}; ask for fewer")


def _place_once(
    rng: np.random.Generator, surface: Surface, radii: NDArray[np.float64], margin: float | NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Place the circles one after another. Return None if one of them finds too little space."""
    margins = np.broadcast_to(margin, len(radii)).tolist()
    circles: list[tuple[float, float, float]] = []
    widest = float(radii.max(initial=0.0))
    for index, radius in enumerate(radii.tolist()):
        half_size = surface.half_extents[0] - margins[index], surface.half_extents[1] - margins[index]
        for _ in range(_MAX_BATCHES):
            draws = rng.random((_FEW if index < _EASY else _MANY, 2))
            centre = _first_free(draws, half_size, circles, radius + surface.gap, widest)
            if centre is not None:
                circles.append((*centre, radius))
                break
        else:
            return None
    return np.array(circles).reshape(-1, 3)[:, :2].copy()


def _first_free(
    draws: NDArray[np.float64],
    half_size: tuple[float, float],
    circles: list[tuple[float, float, float]],
    gap: float,
    widest: float,
) -> tuple[float, float] | None:
    """Find the first candidate whose distance from every circle exceeds the circle's radius plus `gap`, or None.

    Usually one of the first candidates is free. Arrays are made only if none of them is.

    Args:
        draws: (m, 2) in [0, 1), the candidates as fractions of the region.
        half_size: of the region around the origin [m].
        circles: x, y, radius [m] of the circles placed so far.
        gap: [m]
        widest: the largest radius of a circle [m].
    """
    half_x, half_y = half_size
    far = widest + gap
    width_x, width_y = 2 * half_x, 2 * half_y
    for share_x, share_y in draws[:_FEW].tolist():
        x, y = width_x * share_x - half_x, width_y * share_y - half_y
        for other_x, other_y, radius in circles:
            dx = x - other_x
            if -far <= dx <= far:
                dy, reach = y - other_y, radius + gap
                if dx * dx + dy * dy <= reach * reach:
                    break
        else:
            return x, y
    candidates = np.array((width_x, width_y)) * draws[_FEW:] - half_size
    placed = np.array(circles)
    offset_x, offset_y = candidates[:, :1] - placed[:, 0], candidates[:, 1:] - placed[:, 1]
    is_free = (offset_x**2 + offset_y**2 > (placed[:, 2] + gap) ** 2).all(axis=1).tolist()
    if True not in is_free:
        return None
    x, y = candidates[is_free.index(True)].tolist()
    return x, y


_SCREEN = 3
"""Objects of the screen. Three side by side also hide the target from a camera that moves along the table."""
_TALLER = 0.02
"""[m] by which each of them is taller than the target, because the camera looks down."""
_FINGERS = 0.03
"""[m] between neighbours of the screen, and between them and the target: the space that a finger needs between two
objects."""
_SLACK = 0.01
"""[m] Largest additional distance from the target."""
_TURN = 0.05
"""[rad] Largest angle between the screen and the direction to the robot's start."""
_TRIES = 60
"""Attempts to place the target with its screen, and to place each object that overlaps them."""


def screened(rng: np.random.Generator, layout: Layout, scene: TableScene) -> TableScene | None:
    """Make a low object the target and put it behind taller ones. The others stay where they do not overlap.

    Return None if too few objects are taller, or if no placement was found.
    """
    heights = scene.half_extents[:, 2] * 2
    radii = np.where(scene.is_angular, np.hypot(*scene.half_extents[:, :2].T), scene.half_extents[:, 0])
    target = int(rng.choice(np.argsort(heights)[: max(scene.num_objects // 3, 1)]))
    is_taller = (heights > heights[target] + _TALLER) & (scene.levels == scene.levels[target])
    if np.count_nonzero(is_taller) < _SCREEN:
        return None
    screen = rng.choice(np.flatnonzero(is_taller), _SCREEN, replace=False)
    half = np.array((layout.depth, layout.width)) / 2
    for _ in range(_TRIES):
        positions = scene.positions.copy()
        positions[target] = rng.uniform((-half[0] / 2, -half[1]), half)
        heading = math.atan2(*(scene.base[:2] - positions[target])[::-1]) + rng.uniform(-_TURN, _TURN)
        distance = radii[target] + radii[screen] + _FINGERS + rng.uniform(0.0, _SLACK)
        # Neighbours stand `_FINGERS` apart: the angle between them follows from the triangle's sides.
        middle = np.array([(a + b + _FINGERS) / 2 for a, b in zip(radii[screen], radii[screen][1:], strict=False)])
        steps = 2 * np.arcsin(np.minimum(middle / np.minimum(distance[:-1], distance[1:]), 1.0))
        angles = heading + np.array((-steps[0], 0.0, steps[1]))
        positions[screen] = positions[target] + distance[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
        group = [target, *screen.tolist()]
        margin = np.maximum(radii[group], 0.045)[:, None]
        if (np.abs(positions[group]) + margin > half).any() or _overlaps(positions, radii, scene.levels, group):
            continue
        placed = list(group)
        for other in (index for index in range(scene.num_objects) if index not in group):
            for _ in range(_TRIES):
                if not _overlaps(positions, radii, scene.levels, placed, other):
                    break
                room = half - max(radii[other], 0.045)
                positions[other] = rng.uniform(-room, room)
            else:
                break
            placed.append(other)
        if len(placed) == scene.num_objects:
            return replace(scene, positions=positions, target=target)
    return None


def _overlaps(
    positions: np.ndarray, radii: np.ndarray, levels: np.ndarray, group: list[int], one: int | None = None
) -> bool:
    """Whether two objects of a group, or object `one` and any of the group, are less than `OBJECT_GAP` apart."""
    pairs = [(a, b) for a in ([one] if one is not None else group) for b in group if a != b and levels[a] == levels[b]]
    gaps = [np.linalg.norm(positions[a] - positions[b]) - radii[a] - radii[b] for a, b in pairs]
    return bool(gaps) and min(gaps) < OBJECT_GAP - 1e-9
