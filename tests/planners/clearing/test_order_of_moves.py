"""The order of moves under a shelf, and grasps that are kept when other objects move."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest

import clutter_env  # noqa: F401  registers the environments
from planners import Solution, goals, solve
from planners.clearing.order_of_moves import Order, needs_order
from planners.scene import Scene
from planners.workspace import Workspace
from tests.planners.scenes import cylinder, random_shelf, shelf_scene, table_scene

BACK, FRONT = (0.2, 0.0), (-0.2, 0.0)


def order(scene: Scene, goal: goals.Goal, waiting: list[str]) -> list[tuple[str, bool]]:
    """The names that move, and whether to their ends."""
    found = Order.of(scene, goal, waiting, Workspace.of(scene.robot, scene).grasps())
    assert found is not None
    return [(step.name, step.is_general) for step in found.steps(scene, waiting, {})]


def test_what_stands_behind_goes_to_its_place_before_what_stands_in_front_of_it() -> None:
    scene = shelf_scene(cylinder("object_00", -0.2, 0.3), cylinder("object_01", -0.2, -0.3))
    for near, far in (("object_00", "object_01"), ("object_01", "object_00")):
        goal = goals.at(near, FRONT) & goals.at(far, BACK)
        assert order(scene, goal, [near, far]) == [(far, True), (near, True)]


def test_what_is_in_the_way_of_a_place_is_put_aside_and_comes_back_to_its_own() -> None:
    # The gripper comes from the front only, 0.2 m wide: three objects in a row bar the way to what is behind them.
    row = [cylinder(f"object_0{k}", -0.2, y) for k, y in enumerate((-0.1, 0.0, 0.1))]
    scene = shelf_scene(*row, cylinder("object_03", -0.2, 0.35))
    goal = goals.at("object_03", BACK) & goals.at("object_01", FRONT)
    moves = order(scene, goal, ["object_03"])
    names = [name for name, _ in moves]
    assert ("object_03", True) in moves
    if "object_01" in names:
        assert moves[-1] == ("object_01", True)
        assert names.count("object_01") == 2


def test_goals_on_open_tables_and_with_an_order_of_their_own_are_not_ordered() -> None:
    bodies = cylinder("object_00", -0.2, 0.3), cylinder("object_01", -0.2, -0.3)
    goal = goals.at("object_00", BACK)
    assert needs_order(shelf_scene(*bodies), goal)
    assert not needs_order(table_scene(*bodies), goal)
    assert not needs_order(shelf_scene(*bodies), goal & goals.holding("object_01"))


def test_grasps_that_are_kept_are_as_free_as_those_looked_for_anew() -> None:
    scene, rng = random_shelf(6, 3), np.random.default_rng(0)
    workspace = Workspace.of(scene.robot, scene, grasps="side")
    kept = replace(workspace.grasps(), remembers=True)
    for _ in range(2):
        for name in scene.names:
            fewest = [
                min((grasp.blockers.bit_count() for grasp in one.for_object(scene, name)), default=None)
                for one in (kept, workspace.grasps())
            ]
            assert fewest[0] == fewest[1]
        moved = scene.objects[rng.integers(len(scene.objects))]
        places = rng.uniform((-0.3, -0.4), (0.3, 0.4), (100, 2))
        others = np.array([one.position[:2] for one in scene.objects])
        place = places[np.linalg.norm(places[:, None] - others, axis=2).min(axis=1).argmax()]
        scene = scene.with_body(moved.at((*place, moved.position[2])))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [827005, 827013])
def test_objects_are_not_put_aside_again_and_again(seed: int) -> None:
    """One stands on a counter, where the first free grasps have another pitch than those at its end; one was put aside
    in place of another that could not keep clear of all later moves."""
    env = gymnasium.make("clutter_env/Rearrange-o12-v0", task="set", layout="shelf", num_objects=14)
    env.reset(seed=seed)
    inner: Any = env.unwrapped
    scene = Scene.from_mujoco(inner.model, inner.data, inner.robot, regions=inner.regions)
    assert isinstance(solve(scene, inner.goal), Solution)
