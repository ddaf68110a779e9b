"""Bases on narrow strips of floor: the compiled query against the full scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from assets.robots import RobotSpec
from clutter_env.reporting.progress import progress_bar
from irm.floor.free_space import FreeSpace
from irm.maps.cache import cached_map
from irm.queries.full_scan import full_scan
from irm.queries.inverse import InverseReachabilityMap

__all__ = ["Strips", "measure_strips"]


@dataclass(frozen=True)
class Strips:
    """Counts of queries on floors of which only a strip is free."""

    cases: int
    found_by_full_scan: int
    found: int
    same_best: int


def measure_strips(robot: RobotSpec, cases: int, seed: int) -> Strips:
    """Queries with a free strip of floor 5 to 10 cm wide, at random angles and distances."""
    inverse_map = InverseReachabilityMap(cached_map(robot))
    rng = np.random.default_rng(seed)
    scanned = found = same = 0
    for _ in progress_bar(range(cases), "strips"):
        floor = _strip(rng.uniform(0.05, 0.1), rng.uniform(-np.pi, np.pi), rng.uniform(0.3, 1.1), robot.base_radius)
        position = (0.0, 0.0, rng.uniform(0.5, 1.3))
        middle, width = rng.uniform(-np.pi, np.pi), rng.uniform(0.2, np.pi)
        keywords: dict[str, Any] = {"yaw_range": (middle - width, middle + width), "free_space": floor}
        slow, fast = full_scan(inverse_map, position, **keywords), inverse_map.query(position, **keywords)
        scanned += len(slow)
        found += len(slow) and len(fast)
        same += bool(np.array_equal(slow.manipulability, fast.manipulability))
    return Strips(cases, scanned, found, same)


def _strip(width: float, turn: float, away: float, radius: float) -> FreeSpace:
    """Floor between two walls, in which the base's centre has a strip of the given width [m]."""
    c, s = np.cos(turn), np.sin(turn)
    walls = [(c * middle, s * middle, 4.0, 12.0, turn) for middle in (away - 2.0 - radius, away + width + 2.0 + radius)]
    return FreeSpace.from_boxes(walls, radius, (-2.5, -2.5, 2.5, 2.5))
