"""A solved and an unsolvable problem that several test files share."""

from __future__ import annotations

from functools import cache

import numpy as np

from assets.robots import FETCH
from planners import Infeasible, Planner, Solution
from tests.planners.scenes import cylinder, random_scene, table_scene


@cache
def solved(strategy: str = "lookahead") -> Solution:
    """A plan with at least one clearance."""
    planner = Planner(FETCH, grasps="side")
    scene = random_scene(25, 3)
    target = next(name for name in scene.names if planner.clearance_floor(scene, name).count)
    found = planner.solve(scene, target, strategy, np.random.default_rng(0))
    assert isinstance(found, Solution), found
    return found


@cache
def refused() -> Infeasible:
    """The answer for an object on the floor behind the table."""
    body = cylinder("object_00", 0.0, 0.0).at((0.2, 0.0, 0.08))
    found = Planner(FETCH).solve(table_scene(body), "object_00")
    assert isinstance(found, Infeasible), found
    return found
