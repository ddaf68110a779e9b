"""Random scenes, a function of the random generator alone: sizes, places and masses of objects, start of the base.

In screened ones the target stands behind a screen of other objects, as on a shelf that is filled from the back.
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
"""Candidates drawn at once for an object: few for the first `_EASY` objects, of which most are free. Of many the first
few are looked at before the others."""
_EASY = 11
_MAX_BATCHES = 200
_MAX_RESTARTS = 50

MOST_IN_THE_WAY = 2
"""Objects in the way of a drawer at most."""
START_YAW = 0.5
"""[rad] either side of facing the table."""


def sample_scene(
    rng: np.random.Generator,
    layout: Layout,
    num_objects: int,
    shapes: str = "cylinder",
    objects: ObjectSet = OBJECT_SETS["standard"],
) -> TableScene:
    """Objects without overlap, wholly on the table, a target among them, and a base pose in front of it.

    Raises:
        OptionError: no placement was found; cannot happen up to `capacity`.
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
    for row, surface in enumerate(layout.surfaces):  # those of one row have to keep apart
        here = np.flatnonzero(rows == row)
        if objects.kinds:
            here = here[np.argsort(-radii[here], kind="stable")]  # the widest first: they find space last
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
    """A base pose (x, y, yaw) in front of the table, clear of the furniture."""
    (low_x, low_y), (high_x, high_y) = layout.start_region
    low, high = np.array(((low_x, low_y, -START_YAW), (high_x, high_y, START_YAW)))
    base: NDArray[np.float64] = low + (high - low) * rng.random(3)
    return base


def sample_joints(rng: np.random.Generator, layout: Layout) -> NDArray[np.float64]:
    """Dry friction and damping (k, 2) of the joints of what opens, see `opening`; none and nothing drawn without."""
    if layout.opens is None:
        return np.zeros((0, 2))
    low, high = np.array((FRICTION_RANGE, DAMPING_RANGE)).T
    return np.asarray(rng.uniform(low, high, (len(openings_of(layout)), 2)))


def _rows(rng: np.random.Generator, layout: Layout, num_objects: int) -> NDArray[np.int64]:
    """Index (n,) of the surface on which each object stands: all in turn, or few of them in the way of a drawer.

    In drawers side by side any of them, as many in each as in the next, or one more: neither a number nor a shape says
    where.
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
    """A slot of an object inside, -1 without any; of drawers side by side all are as likely to have it."""
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
    """Positions (n, 2) of circles that keep the surface's gap apart, uniform over what is free.

    `margin` [m], one or (n,), is that of their centres to the edges.
    """
    for _ in range(_MAX_RESTARTS):
        positions = _place_once(rng, surface, radii, margin)
        if positions is not None:
            return positions + surface.centre
    raise OptionError(f"no space for {len(radii)} objects on layout {layout.name!r}; ask for fewer")


def _place_once(
    rng: np.random.Generator, surface: Surface, radii: NDArray[np.float64], margin: float | NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """One attempt, object by object; None when the next object found no space."""
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
    """The first of the candidates that is farther from every circle than its radius and `gap`, None without one.

    Mostly one of the first is free: arrays are made only when none of them is.

    Args:
        draws: (m, 2) in [0, 1), the candidates as shares of the region.
        half_size: of the region around the origin [m].
        circles: x, y, radius [m] of what is placed already.
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
"""Objects of the screen: side by side they hide the target from a camera that moves along the table, too."""
_TALLER = 0.02
"""[m] by which each of them is taller than the target: the camera looks down."""
_FINGERS = 0.03
"""[m] between them, and between them and the target: what a finger needs that is to go between two objects."""
_SLACK = 0.01
"""[m] by which they stand farther from the target, at most."""
_TURN = 0.05
"""[rad] by which the screen is turned away from the robot's start, at most."""
_TRIES = 60
"""Places tried for the target with its screen, and for each other object that is in their way."""


def screened(rng: np.random.Generator, layout: Layout, scene: TableScene) -> TableScene | None:
    """The scene with a low object as the target behind taller ones; the others stay where they do not overlap.

    None if too few objects are taller, or if no place was found.
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
    """Whether two objects of a group, or another one and any of them, are less than `OBJECT_GAP` apart."""
    pairs = [(a, b) for a in ([one] if one is not None else group) for b in group if a != b and levels[a] == levels[b]]
    gaps = [np.linalg.norm(positions[a] - positions[b]) - radii[a] - radii[b] for a, b in pairs]
    return bool(gaps) and min(gaps) < OBJECT_GAP - 1e-9
