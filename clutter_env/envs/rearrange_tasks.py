"""The tasks of `Rearrange`: for each, the table that it needs, how its objects stand at the start, and its goal.

All are functions of the random generator alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import OptionError
from clutter_env.scene.layout import OBJECT_GAP, SECOND_TABLE, TABLE, TABLE_HEIGHT, TRAY, Layout, supports_of
from clutter_env.scene.table_scene import TableScene, object_name
from planners import goals
from planners.goals import At, Goal, Region

Rng: TypeAlias = np.random.Generator

PLACE_HALF = 0.06
"""[m] Half of a side of a place of "set": 25 mm are left on each side of the largest random object."""
_SIDE_GAP = 0.005
"""[m] left on each side of an object in a place of "set" at least."""
PLACE_PITCH = 0.16
"""[m] between the centres of neighbouring places: fingers fit between objects that stand in both."""
MOST_CYCLED = 6
"""Objects that change places in "swap" at most."""
STACK = 3
"""Objects of the stack at the start of "stack", and of the stack in its goal."""
MOST_FETCHED = 3
"""Objects that "fetch" asks for at most."""
_MAX_DRAWS = 500
"""Choices of objects and places that are tried until the objects fit where they are to stand."""


@dataclass(frozen=True)
class DrawnGoal:
    """A goal, and the regions that it may name."""

    goal: Goal
    regions: tuple[Region, ...] = ()


@dataclass(frozen=True)
class Task:
    """A task, as data.

    Attributes:
        layout: name of the default layout.
        object_set: name of the default object set.
        shapes: default shapes of the objects.
        least: least number of objects.
        draw: the goal for a scene.
        needs: prefix of the name of a support that the layout must have, "" if any layout suits.
        arrange: rearranges the objects of a random scene at the start. By default they stand as in `random_scene`.
    """

    layout: str
    object_set: str
    shapes: str
    least: int
    draw: Callable[[Rng, Layout, TableScene], DrawnGoal]
    needs: str = ""
    arrange: Callable[[Rng, TableScene], TableScene] = lambda _, scene: scene

    def fits(self, layout: Layout) -> bool:
        """Whether a layout has the support that the task needs."""
        return any(name.startswith(self.needs) for name in supports_of(layout))


def _sort(rng: Rng, layout: Layout, scene: TableScene) -> DrawnGoal:
    """Each object into one of the trays, with equal numbers per tray, or one more."""
    names, count = [name for name in supports_of(layout) if name.startswith(TRAY)], scene.num_objects
    chosen = rng.permutation(np.arange(count) % len(names))
    return DrawnGoal(goals.and_(*(goals.on(object_name(slot), names[tray]) for slot, tray in enumerate(chosen))))


def _set(rng: Rng, layout: Layout, scene: TableScene) -> DrawnGoal:
    """Half of the objects into places of a grid, each into another. Other objects may stand there at the start.

    Objects wider than a place are never chosen.
    """
    fitting = np.flatnonzero((scene.standing_extents[:, :2] <= PLACE_HALF - _SIDE_GAP).all(axis=1))
    count, grid = min((scene.num_objects + 1) // 2, len(fitting)), _places(layout)
    if not count:
        raise OptionError(f"task 'set': no object is narrower than a place, which is {2 * PLACE_HALF:.2f} m wide")
    if len(grid) < count:
        raise OptionError(f"task 'set': layout {layout.name!r} has {len(grid)} places, fewer than {count} objects")
    half = (PLACE_HALF, PLACE_HALF)
    regions = [
        Region(f"place_{number:02d}", grid[cell][0], grid[cell][1:], half)
        for number, cell in enumerate(np.sort(rng.choice(len(grid), count, replace=False)))
    ]
    chosen = rng.choice(fitting, count, replace=False)
    facts = [goals.inside(object_name(int(slot)), region.name) for slot, region in zip(chosen, regions, strict=True)]
    return DrawnGoal(goals.and_(*facts), tuple(regions))


def _places(layout: Layout) -> list[tuple[str, float, float]]:
    """Support, x and y [m] of all places: a square grid on the table, and on a shelf on which objects stand."""
    rows, columns = int(layout.depth / PLACE_PITCH), int(layout.width / PLACE_PITCH)
    faces = [TABLE] if len(layout.levels) == 1 else [TABLE, "shelf_board"]
    xs, ys = (PLACE_PITCH * (np.arange(n) - (n - 1) / 2) for n in (rows, columns))
    return [(face, float(x), float(y)) for face in faces for x in xs for y in ys]


def _swap(rng: Rng, layout: Layout, scene: TableScene) -> DrawnGoal:  # noqa: ARG001  as of the other tasks
    """Two to six objects each take the place of the next one of them, the last that of the first."""
    count = scene.num_objects
    for draw in range(_MAX_DRAWS):
        most = min(MOST_CYCLED, count) if draw < _MAX_DRAWS // 2 else 2  # two nearly always fit
        cycle = rng.choice(count, rng.integers(2, most + 1), replace=False)
        after = np.arange(count)
        after[cycle] = np.roll(cycle, -1)
        if _are_apart(scene, scene.positions[after], scene.levels[after]):
            break
    else:
        raise OptionError("task 'swap': no two of these objects can change places; give them more room")
    # Where one board lies above another the height says on which of them.
    heights = TABLE_HEIGHT + scene.levels[after] + scene.standing_extents[:, 2]
    is_high, facts = np.ptp(scene.levels) > 0, []
    for slot in cycle.tolist():
        x, y = map(float, scene.positions[after[slot]])
        facts.append(At(object_name(slot), x, y, z=float(heights[slot]) if is_high else None))
    return DrawnGoal(Goal(tuple(facts)))


def _are_apart(scene: TableScene, positions: NDArray[np.float64], levels: NDArray[np.float64]) -> bool:
    """Whether the objects keep `OBJECT_GAP` apart at these positions (n, 2) [m] and levels (n,) [m]."""
    half_x, half_y = scene.standing_extents[:, 0], scene.standing_extents[:, 1]
    radii = np.where(scene.is_angular, np.hypot(half_x, half_y), half_x)
    gaps = np.linalg.norm(positions[:, None] - positions, axis=-1) - radii[:, None] - radii
    is_beside = (levels[:, None] == levels) & ~np.eye(len(radii), dtype=bool)
    return bool((gaps[is_beside] >= OBJECT_GAP).all())


def _stack(rng: Rng, layout: Layout, scene: TableScene) -> DrawnGoal:  # noqa: ARG001  as of the other tasks
    """Three objects one on the other, the lowest on the table."""
    names = [object_name(int(slot)) for slot in rng.choice(scene.num_objects, STACK, replace=False)]
    below = [TABLE, *names]
    return DrawnGoal(goals.and_(*(goals.on(name, place) for name, place in zip(names, below, strict=False))))


def _stacked(rng: Rng, scene: TableScene) -> TableScene:
    """Three of the objects, one on the other, where the lowest one stood."""
    chosen = rng.choice(scene.num_objects, STACK, replace=False)
    positions, levels = scene.positions.copy(), scene.levels.copy()
    for below, above in pairwise(chosen):
        positions[above] = positions[below]
        levels[above] = levels[below] + 2 * scene.standing_extents[below, 2]
    return replace(scene, positions=positions, levels=levels)


def _fetch(rng: Rng, layout: Layout, scene: TableScene) -> DrawnGoal:  # noqa: ARG001  as of the other tasks
    """Two or three objects to the second table, two if fewer than six objects exist."""
    count = min(MOST_FETCHED, max(2, scene.num_objects // 2))
    names = [object_name(int(slot)) for slot in rng.choice(scene.num_objects, count, replace=False)]
    return DrawnGoal(goals.and_(*(goals.on(name, SECOND_TABLE) for name in names)))


TASKS: Mapping[str, Task] = MappingProxyType(
    {
        "sort": Task("trays", "standard", "cylinder", 1, _sort, TRAY),
        "set": Task("paper", "standard", "cylinder", 1, _set),
        "swap": Task("paper", "standard", "cylinder", 2, _swap),
        "stack": Task("paper", "blocks", "box", STACK, _stack, arrange=_stacked),
        "fetch": Task("two_tables", "standard", "cylinder", 2, _fetch, SECOND_TABLE),
    }
)
"""All tasks, by name."""
