"""Random scenes whose target stands behind a screen of other objects, as on a shelf that is filled from the back."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from clutter_env.scene.layout import Layout
from clutter_env.scene.object_sets import OBJECT_GAP
from clutter_env.scene.table_scene import TableScene

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
