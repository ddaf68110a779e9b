"""Which locations are tried for an object in hand, how many, and in which order."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from assets.robots import FETCH
from planners.clearing.commitments import grasped
from planners.collision.world import CollisionWorld
from planners.goals import Goal, Region, inside
from planners.motion.approaches import stand_off
from planners.placing import placements
from planners.placing.goal_places import place_of
from planners.placing.locations import placement_levels, stand_at
from planners.placing.placements import Placement, PlacementSearch
from planners.placing.surfaces import KeepClear, UnknownSupport, find_supports
from planners.planner import Planner, solve
from planners.scene import Scene, StaticObstacle
from planners.scene.masks import FIXED_BITS
from planners.strategies import STRATEGIES, Strategy, StrategyError
from planners.tamp.solution import Infeasible, Solution
from planners.workspace import Workspace
from tests.planners.scenes import HEIGHT, cylinder, shelf_scene, table_scene

CHOICES = ("name", "grasps", "region", "locations")
PLANNING_AHEAD = ("plans_ahead", "tries")


@pytest.fixture(scope="module")
def in_hand() -> Scene:
    """One of two objects of a nearly empty table, grasped."""
    scene = table_scene(cylinder("object_00", -0.2, 0.1), cylinder("object_01", 0.0, -0.3))
    return grasped(scene, Workspace.of(scene.robot, scene, grasps="side").grasps().for_object(scene, "object_00")[0])


def search(scene: Scene) -> PlacementSearch:
    return Workspace.of(scene.robot, scene, grasps="side").placements()


def locations_tried(
    scene: Scene, strategy: Strategy, monkeypatch: pytest.MonkeyPatch, supports: tuple[str, ...] = ()
) -> dict[str, list[NDArray[np.float64]]]:
    """The locations at which each part of the search looks, level by level, if it never finds anything."""
    tried: dict[str, list[list[NDArray[np.float64]]]] = {"_from_here": [], "_after_a_drive": []}
    last = ""

    def recorder(name: str) -> Any:
        def record(
            _search: PlacementSearch,
            _world: CollisionWorld,
            location: NDArray[np.float64],
            _poses: object,
            most: int = 0,  # noqa: ARG001  as of the search
        ) -> Iterator[Placement]:
            nonlocal last
            if last != name or not tried[name]:
                tried[name].append([])
            last = name
            tried[name][-1].append(location)
            return iter(())

        return record

    for name in tried:
        monkeypatch.setattr(PlacementSearch, name, recorder(name))
    world = CollisionWorld.from_scene(scene)
    finder = replace(search(scene), supports=supports)
    assert next(finder.find(world, KeepClear(), strategy, np.random.default_rng(0)), None) is None
    return {name: [np.array(level) for level in levels] for name, levels in tried.items()}


def test_strategies_differ_in_three_choices_and_in_planning_ahead() -> None:
    budget = [field.name for field in fields(Strategy) if field.name not in (*CHOICES, *PLANNING_AHEAD)]
    assert {"attempts", "locations_per_level", "placements", "leaves_cleared"} <= set(budget)
    assert len({tuple(getattr(strategy, name) for name in budget) for strategy in STRATEGIES.values()}) == 1
    greedy = [strategy for strategy in STRATEGIES.values() if not strategy.plans_ahead]
    assert len({tuple(getattr(strategy, name) for name in PLANNING_AHEAD) for strategy in greedy}) == 1


def test_every_strategy_tries_as_many_locations(in_hand: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a base motion all of them, from where the base stands those within reach."""
    counts = {}
    for name, strategy in STRATEGIES.items():
        tried = locations_tried(in_hand, strategy, monkeypatch)
        counts[name] = sum(map(len, tried["_after_a_drive"]))
        assert 0.9 * counts[name] < sum(map(len, tried["_from_here"])) <= counts[name]
    assert len(set(counts.values())) == 1, counts


@pytest.mark.parametrize(("field", "value"), [("attempts", 0), ("tries", 1.5), ("tries", -1), ("placements", None)])
def test_a_budget_that_is_none_is_refused(field: str, value: Any) -> None:
    with pytest.raises(StrategyError, match=f"{field}=.*integer of at least"):
        replace(STRATEGIES["ngr"], **{field: value})


def test_farthest_within_reach_first_however_many_locations_there_are(
    in_hand: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = locations_tried(in_hand, replace(STRATEGIES["ngr"], locations_per_level=5), monkeypatch)
    every = locations_tried(in_hand, replace(STRATEGIES["ngr"], locations_per_level=10_000), monkeypatch)
    here = in_hand.state.base[:2]
    for some, of_all in zip(tried["_from_here"], every["_from_here"], strict=True):
        distances = np.linalg.norm(some[:, :2] - here, axis=1)
        assert np.array_equal(some, of_all[:5])
        assert distances[0] == np.linalg.norm(of_all[:, :2] - here, axis=1).max()
        assert (np.diff(distances) <= 0).all()
    for some, of_all in zip(tried["_after_a_drive"], every["_after_a_drive"], strict=True):
        assert np.array_equal(some, of_all[:5])
        assert (np.diff(np.linalg.norm(of_all[:, :2] - here, axis=1)) >= 0).all()


def test_no_location_that_the_arm_can_serve_counts_as_out_of_reach(
    in_hand: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    finder, world = search(in_hand), CollisionWorld.from_scene(in_hand)
    level = list(placement_levels(in_hand.support, np.random.default_rng(0)))[2]
    locations = np.column_stack((level, np.full(len(level), in_hand.support.top)))
    assert not placements._is_within_reach(in_hand, locations).all()
    with monkeypatch.context() as patch:
        patch.setattr(placements, "can_reach", lambda _scene, poses: np.ones(len(poses), dtype=bool))
        poses = [placements._free_of(world)(some) for some in placements.gripper_poses_at(in_hand, locations)]
        found = (finder._from_here(world, *place) for place in zip(locations, poses, strict=True))
        placements_there = list(itertools.chain(*found))
    served = np.array([placement.location for placement in placements_there])
    assert len(served) > 50
    assert placements._is_within_reach(
        in_hand, np.column_stack((served, np.full(len(served), in_hand.support.top)))
    ).all()


def test_supports_are_names_that_the_scene_declares() -> None:
    scene = replace(table_scene(), supports=("table_top", "counter_left"))
    assert find_supports(scene, None) == ("table_top",)
    assert find_supports(scene, "all") == ("table_top", "counter_left")
    assert find_supports(scene, ["counter_left"]) == find_supports(scene, "counter_left") == ("counter_left",)
    for wrong in (("counter_right",), (), "wall", 3):
        with pytest.raises(UnknownSupport, match=r"supports=.*table_top, counter_left"):
            find_supports(scene, wrong)


def test_a_planner_refuses_to_put_objects_nowhere() -> None:
    """It put them where it would have by default."""
    with pytest.raises(UnknownSupport, match=r"supports=\(\) is not valid"):
        Planner(FETCH, supports=()).workspace(table_scene())


def test_locations_of_all_supports_are_tried_level_by_level(in_hand: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Within a level their order is that of their distances, whichever support they are on."""
    names = ("table_top", "counter_left", "counter_right")
    many = replace(STRATEGIES["ngr"], locations_per_level=10_000)
    on_table = locations_tried(in_hand, many, monkeypatch)["_after_a_drive"]
    everywhere = locations_tried(in_hand, many, monkeypatch, names)["_after_a_drive"]
    here = in_hand.state.base[:2]
    owners = [in_hand.support_named(name) for name in names]
    for some, of_all in zip(on_table, everywhere, strict=True):
        assert (np.diff(np.linalg.norm(of_all[:, :2] - here, axis=1)) >= 0).all()
        on = [np.abs(of_all[:, 1] - owner.position[1]) < owner.extent[1] for owner in owners]
        assert np.sum(on, axis=0).tolist() == [1] * len(of_all)
        assert all(inside.any() for inside in on)
        if len(some) < 30:  # the finer grids are moved at random
            assert {tuple(place) for place in some} == {tuple(place) for place in of_all[on[0]]}


def test_an_object_stands_on_one_support_wholly_and_as_high_as_that(in_hand: Scene) -> None:
    """Table and counters adjoin; a low stool is another support."""
    stool = StaticObstacle("stool", np.array([-0.2, 1.4, 0.3]), np.array([0.15, 0.15, 0.3]))
    scene = replace(in_hand, static_obstacles=(*in_hand.static_obstacles, stool))
    world, names = CollisionWorld.from_scene(scene), ("table_top", "counter_left", "stool")
    for name in names:
        support = scene.support_named(name)
        finder = replace(search(scene), supports=(name,))
        found = finder.find(world, KeepClear(), STRATEGIES["srivastava"], np.random.default_rng(0))
        first = list(itertools.islice(found, 3))
        assert len(first) == 3
        for placement in first:
            body = placement.body
            away = np.abs(body.position[:2] - support.position[:2])
            assert (away + body.radius <= support.extent[:2]).all()
            assert body.bottom == pytest.approx(support.top, abs=1e-9)


def test_under_a_shelf_the_drive_in_begins_where_what_is_carried_fits() -> None:
    """Beside a post the gripper comes from the side; the base then stands so near that the board is in the way."""
    scene = shelf_scene(cylinder("object_00", -0.29, -0.15, 0.027, 0.175), cylinder("object_01", -0.3, -0.4, 0.03))
    workspace = Workspace.of(scene.robot, scene, grasps="side")
    free = next(one for one in workspace.grasps().for_object(scene, "object_00") if not one.blockers)
    world, outside = CollisionWorld.from_scene(grasped(scene, free)), []
    for x, y in ((-0.21, -0.38), (-0.22, -0.36)):
        for placement in workspace.placements().about(world, np.array([x, y, scene.support.top])):
            outside.append(stand_off(world.scene, placement.base, placement.q, placement.body))
    held, home = world.scene.held, np.array(scene.robot.home)
    assert outside
    assert not any(world.hits(base, home, 0.0, held) & FIXED_BITS for base in outside)


def test_under_a_shelf_the_deepest_row_that_the_gripper_reaches_is_filled_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Low boards leave a tilted gripper room at the front alone; the tries were all spent on the row at the back.

    What was then put at the very front stood in the way of the others.
    """
    scene = shelf_scene(cylinder("object_00", -0.29, -0.15, 0.027, 0.175))
    region = Region("back to front", scene.support.name, (0.0, 0.0), (0.27, 0.3))
    scene, front = replace(scene, regions=(region,)), -0.2
    workspace = Workspace.of(scene.robot, scene, grasps="side")
    carrying = grasped(scene, workspace.grasps().for_object(scene, "object_00")[0])

    def at_the_front(
        _search: PlacementSearch, world: CollisionWorld, location: NDArray[np.float64], _free: object, _most: int = 0
    ) -> Iterator[Placement]:
        if location[0] < front:
            body = stand_at(world.scene.body("object_00"), location)
            yield Placement(body, np.array([-1.0, 0.0, 0.0]), np.zeros(8), 0.0, 0.0, 0.1)

    monkeypatch.setattr(PlacementSearch, "_held_at", at_the_front)
    place = place_of(scene, inside("object_00", region.name).placed[0])
    found = next(workspace.placements().find_at(CollisionWorld.from_scene(carrying), place, KeepClear()), None)
    assert found is not None
    assert front - 0.02 < found.body.position[0] < front


def bin_of(height: float) -> tuple[StaticObstacle, ...]:
    """A bin on the table, 11 cm wide inside, whose walls begin 1 cm above it."""
    walls = (
        StaticObstacle(
            f"bin_{number}",
            np.array([-0.2 + 0.06 * x, 0.2 + 0.06 * y, HEIGHT + 0.01 + height / 2]),
            np.array([0.005 if x else 0.065, 0.005 if y else 0.065, height / 2]),
        )
        for number, (x, y) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1)))
    )
    return StaticObstacle("bin", np.array([-0.2, 0.2, HEIGHT + 0.005]), np.array([0.065, 0.065, 0.005])), *walls


@pytest.mark.parametrize(("drop", "height"), [(0.0, 0.12), (0.1, 0.12), (0.0, 0.25)])
def test_an_object_falls_into_a_bin_whose_walls_keep_the_hand_out(drop: float, height: float) -> None:
    """From as high as the region says, else from as high as things may fall in any container: no deeper."""
    things = cylinder("object_00", -0.2, -0.2, 0.02, 0.04), cylinder("object_01", -0.2, 0.0, 0.02, 0.04)
    walls = bin_of(height)
    pit = Region("pit", "bin", (-0.2, 0.2), (0.05, 0.05), drop=drop)
    spot = Region("spot", "table_top", (0.0, -0.4), (0.1, 0.1))
    scene = table_scene(*things)
    static = (*scene.static_obstacles, *walls)
    scene = replace(scene, static_obstacles=static, regions=(pit, spot), supports=("table_top", "bin"))
    goal = Goal.of((("on", "object_00", "pit"), ("on", "object_01", "spot"), ("before", "object_00", "object_01")))
    solution = solve(scene, goal, grasps="top", rng=np.random.default_rng(0))
    if height > 0.2:
        assert isinstance(solution, Infeasible)
        assert re.search(r"between the walls of bin, 1\d\d mm apart and \d+ mm high, a hand that is", solution.detail)
        assert "it has room from" in solution.detail
        return
    assert isinstance(solution, Solution)
    body = solution.actions[-1].scene.body("object_00")
    assert body.bottom == pytest.approx(walls[0].top, abs=0.003), "it lies on the floor of the bin"
    assert np.abs(body.position[:2] - pit.centre).max() < 0.02, "it was let go in the middle"


def test_a_search_that_turns_least_releases_as_it_took_where_that_is_free() -> None:
    scene = table_scene(cylinder("object_00", -0.2, 0.1))
    workspace = Workspace.of(scene.robot, scene, saves_time=True)
    found = [grasp for grasp in workspace.grasps().of_all_families(scene, "object_00") if not grasp.blockers]
    turned = max(found, key=lambda grasp: abs(grasp.yaw))
    for turns_least in (False, True):
        search = replace(workspace.placements(), turns_least=turns_least)
        world = CollisionWorld.from_scene(grasped(scene, turned))
        placement = next(search.find(world, KeepClear(), STRATEGIES["lookahead"], np.random.default_rng(0)))
        turn = abs(np.remainder(placement.yaw - turned.yaw + np.pi, 2 * np.pi) - np.pi)
        assert (turn < np.pi / 24) == turns_least
