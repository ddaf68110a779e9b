"""Scenes in which what is put aside finds no place out of the way of all that follows."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest

from assets.robots import FETCH
from planners.cause import Cause
from planners.placing.placements import PlacementSearch
from planners.planner import Planner
from planners.scene import HeldObject, Scene, StaticObstacle
from planners.strategies import STRATEGIES
from planners.tamp.solution import Infeasible, Solution
from tests.planners.scenes import HEIGHT, cylinder, table_scene

HALF = 0.2
"""[m] half the side of a table between two counters and a wall."""
TWICE = replace(STRATEGIES["lookahead"], attempts=1)


def crowded(seed: int, count: int) -> Scene:
    """`count` cylinders at random places on the small table, 14 mm apart at least."""
    rng = np.random.default_rng(seed)
    places: list[tuple[float, float]] = []
    while len(places) < count:
        x, y = rng.uniform(-HALF + 0.035, HALF - 0.035), rng.uniform(-HALF + 0.035, HALF - 0.035)
        if all(np.hypot(x - a, y - b) > 0.074 for a, b in places):
            places.append((x, y))
    scene = table_scene(*(cylinder(f"object_{i:02d}", x, y) for i, (x, y) in enumerate(places)))
    top = StaticObstacle("table_top", np.array([0.0, 0.0, HEIGHT - 0.02]), np.array([HALF, HALF, 0.02]))
    wall = StaticObstacle("wall", np.array([HALF + 0.02, 0.0, 0.8]), np.array([0.02, 1.0, 0.8]))
    sides = (
        StaticObstacle(name, np.array([0.0, sign * (HALF + 0.31), 0.375]), np.array([HALF, 0.3, 0.375]))
        for name, sign in (("left", 1), ("right", -1))
    )
    return replace(scene, static_obstacles=(top, wall, *sides))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return crowded(4, 11)


def test_one_more_pick_where_there_is_no_room_for_the_fewest() -> None:
    planner, scene = Planner(FETCH, grasps="side"), crowded(3, 12)
    floor = planner.clearance_floor(scene, "object_01")
    plan = planner.solve(scene, "object_01", TWICE)
    assert isinstance(plan, Solution), plan
    assert floor.count is not None
    assert plan.picks == floor.count + 2  # one more than the floor, and the target
    assert plan.actions[-1].target == "object_01"
    for before, after in zip(plan.actions, plan.actions[1:], strict=False):
        if before.released is not None:
            np.testing.assert_allclose(after.scene.body(before.target).position, before.released.position, atol=1e-6)


@pytest.mark.slow
def test_the_search_is_bounded() -> None:
    """A table with no room at all ends with the cause."""
    found = Planner(FETCH, grasps="side").solve(crowded(1, 16), "object_05", TWICE)
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.NO_CLEARANCE_LOCATION


def test_a_tight_flower_is_infeasible_for_every_plan() -> None:
    """Whatever a plan does, it must first take some object that stands as now; there is no grasp for any."""
    petals = [(0.062 * np.cos(a), 0.062 * np.sin(a)) for a in np.arange(6) * np.pi / 3]
    scene = table_scene(*(cylinder(f"object_{i:02d}", x, y) for i, (x, y) in enumerate([(0.0, 0.0), *petals])))
    planner = Planner(FETCH, grasps="side")
    floor = planner.clearance_floor(scene, "object_00")
    assert floor.is_infeasible
    assert (floor.count, floor.proved, floor.cause) == (None, True, Cause.NO_SELF_CLEARABLE_SET)
    found = planner.solve(scene, "object_00")
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.NO_SELF_CLEARABLE_SET


def test_no_place_is_looked_for_again_for_what_is_held_and_fits_nowhere(scene: Scene) -> None:
    wide = replace(scene.body("object_00"), half_extents=np.array([0.15, 0.15, 0.08]))
    holding = scene.with_body(wide).with_held(HeldObject("object_00", np.eye(4)))
    planner = Planner(FETCH, grasps="side")
    planner.solve(holding, "object_05", TWICE)  # the first plan of a process loads kernels, and looks for places for it
    with patch.object(PlacementSearch, "find", autospec=True, side_effect=PlacementSearch.find) as find:
        outcome = planner.solve(holding, "object_05", TWICE)
    assert isinstance(outcome, Infeasible)
    assert (outcome.cause, outcome.objects) == (Cause.NO_CLEARANCE_LOCATION, ("object_00",))
    # With all, some and nothing to keep clear of, in two attempts. Then once from many base poses, with all and some.
    assert find.call_count <= 8
