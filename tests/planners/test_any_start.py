"""Starts that `reset` allows: objects on objects, and an arm that is not at home."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from assets.robots import FETCH
from planners import Solution, clearance_floor, solve
from planners.collision.scene_arrays import robot_arrays
from planners.collision.world import CollisionWorld, objects_on
from planners.scene import Body, RobotState, Scene
from tests.planners.plans import assert_free
from tests.planners.scenes import HEIGHT, UPRIGHT, cylinder, random_scene, table_scene


def stacked(body: Body, under: Body, offset: float = 0.0) -> Body:
    """The object on top of another, its axis `offset` [m] beside the other one's."""
    return body.at([under.position[0] + offset, under.position[1], under.top + body.position[2] - body.bottom])


def tower(height: int) -> Scene:
    """That many cylinders on each other, "level_0" lowest, and one beside them."""
    levels = [cylinder("level_0", -0.1, 0.0)]
    for level in range(1, height):
        levels.append(stacked(cylinder(f"level_{level}", -0.1, 0.0, height=0.09), levels[-1]))
    return table_scene(*levels, cylinder("beside", -0.1, 0.3))


@pytest.mark.parametrize("height", [2, 3])
def test_what_stands_on_the_target_is_cleared_first(height: int) -> None:
    """The floor was "0, proved" and the solve ended without a plan."""
    scene = tower(height)
    floor = clearance_floor(scene, "level_0")
    above = tuple(f"level_{level}" for level in reversed(range(1, height)))
    assert floor.proved
    assert floor.objects == above
    solution = solve(scene, "level_0")
    assert isinstance(solution, Solution)
    assert solution.clearances == above


def test_the_top_of_a_tower_is_taken_at_once() -> None:
    solution = solve(tower(3), "level_2")
    assert isinstance(solution, Solution)
    assert solution.clearances == ()


@pytest.mark.parametrize(
    ("offset", "gap", "stands"), [(0.0, 0.0, True), (0.055, 0.0, True), (0.065, 0.0, False), (0.0, 0.01, False)]
)
def test_an_object_stands_on_another_if_they_touch(offset: float, gap: float, stands: bool) -> None:
    """Both cylinders have a radius of 3 cm."""
    below = cylinder("below", 0.0, 0.0)
    above = stacked(cylinder("above", 0.0, 0.0), below, offset)
    world = CollisionWorld.from_scene(table_scene(below, above.at(above.position + [0.0, 0.0, gap])))
    assert bool(objects_on(world, "below")) == stands
    assert objects_on(world, "above") == 0


def test_a_thin_sheet_stands_neither_on_itself_nor_on_one_beside_it() -> None:
    """It was in its own way, which ended the search with an exception."""
    sheets = [
        Body(name, "box", np.array((0.04, 0.04, 0.002)), np.array((-0.25, y, HEIGHT + 0.002)), UPRIGHT)
        for name, y in (("one", 0.0), ("other", 0.081))
    ]
    scene = table_scene(*sheets)
    world = CollisionWorld.from_scene(scene)
    assert objects_on(world, "one") == objects_on(world, "other") == 0
    on_top = scene.with_body(sheets[1].at((-0.25, 0.02, HEIGHT + 0.006)))
    assert objects_on(CollisionWorld.from_scene(on_top), "one") == 2
    assert isinstance(solve(scene, "one"), Solution)


def somewhere(scene: Scene, rng: np.random.Generator) -> RobotState:
    """The robot at a random base pose in a random configuration, both free."""
    world, arrays = CollisionWorld.from_scene(scene), robot_arrays(FETCH)
    lower, upper = np.maximum(arrays.lower, -np.pi), np.minimum(arrays.upper, np.pi)
    while True:
        base, q = rng.uniform([-1.3, -0.5, -np.pi], [-0.7, 0.5, np.pi]), rng.uniform(lower, upper)
        if not any(world.hits(base, q, opening) for opening in (0.0, FETCH.max_opening)):
            return RobotState(base, q, FETCH.max_finger_position)


@pytest.mark.parametrize("seed", range(4))
def test_the_robot_may_start_in_any_configuration(seed: int) -> None:
    """Refused as unreachable: no base motion was free with the arm as it was."""
    scene = random_scene(12, seed)
    scene = scene.with_state(somewhere(scene, np.random.default_rng(seed)))
    solution = solve(scene, "object_00")
    assert isinstance(solution, Solution)
    np.testing.assert_allclose(solution.actions[0].trajectory.states[0, :-1], [*scene.state.base, *scene.state.q])
    for before, after in itertools.pairwise(solution.actions):
        np.testing.assert_allclose(before.trajectory.states[-1, :-1], after.trajectory.states[0, :-1], atol=1e-9)
    assert_free(solution)


def test_a_gripper_that_is_not_fully_open_drives_away_where_an_open_one_would_touch() -> None:
    """After something was put on a counter from its far side, the fingers are as far apart as they were for that."""
    scene = table_scene(cylinder("a", -0.15, -0.2))
    beside = RobotState(np.array([-0.11955888, 1.41362266, -1.04719858]), np.array(FETCH.home), 0.043736624)
    assert isinstance(solve(scene.with_state(beside), "a"), Solution)
