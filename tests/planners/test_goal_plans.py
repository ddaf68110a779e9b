"""Plans for goals with places: what they bring about, in how many picks, and in which order."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401  registers the environments
from assets import robot
from assets.robots import FETCH
from planners import (
    STRATEGIES,
    AntipodalFamily,
    Cause,
    Infeasible,
    Planner,
    Region,
    RobotState,
    Scene,
    Solution,
    StaticObstacle,
    goals,
    lower_bound,
    solve,
    warmup,
)
from planners.goals import Goal
from planners.grasping.candidates import GraspCandidate
from planners.motion.path import BlockedBy, NoPath
from planners.placing.placements import Placement
from planners.scene import Body, Solid
from planners.tamp.motion_layer import MotionLayer
from scripts.goal_bounds import drawn as drawn_close
from scripts.goal_measures import drawn
from tests.planners.pieces import bottle, bowl, cut_in_two
from tests.planners.plans import assert_free
from tests.planners.scenes import BOARD_HEIGHT, HEIGHT, UPRIGHT, cylinder, random_scene, shelf_scene, table_scene

SIDES = ("table_top", "counter_left", "counter_right")
LEFT = Region("left", "counter_left", (-0.15, 0.72), (0.12, 0.12))


@cache
def scene_of(kind: str) -> Scene:
    if kind == "few":
        scene = random_scene(4, 0)
    elif kind.startswith("stack"):
        low = cylinder("a", -0.1, 0.0, 0.035, 0.08)
        stacked = [low.at(low.position + [0.0, 0.0, 0.08 * k]) for k in range(3)]
        beside = (cylinder("d", -0.2, 0.35, 0.035, 0.08),) if kind == "stack and one" else ()
        scene = table_scene(*(replace(one, name=name) for one, name in zip(stacked, "abc", strict=True)), *beside)
    else:
        scene = table_scene(
            *(cylinder(name, -0.2, y, 0.035, 0.08) for name, y in zip("abc", (-0.3, 0, 0.3), strict=True))
        )
    tray = StaticObstacle("tray", np.array([-0.15, -0.72, HEIGHT + 0.004]), np.array([0.17, 0.17, 0.004]))
    walls = [
        StaticObstacle(f"wall_{i}", tray.position + [x, y, 0.015], np.array([a, b, 0.015]))
        for i, (x, y, a, b) in enumerate(
            ((0.174, 0, 0.004, 0.17), (-0.174, 0, 0.004, 0.17), (0, 0.174, 0.17, 0.004), (0, -0.174, 0.17, 0.004))
        )
    ]
    obstacles = (*scene.static_obstacles, tray, *walls)
    return replace(scene, static_obstacles=obstacles, supports=(*SIDES, "tray"), regions=(LEFT,))


def shifted(scene: Scene, names: tuple[str, ...]) -> Goal:
    """Each object at the place of the next."""
    return goals.and_(
        *(goals.at(a, scene.body(b).position[:2], 0.01) for a, b in zip(names, (*names[1:], names[0]), strict=True))
    )


FEW = random_scene(4, 0).names
CASES = {
    "one held high up, as not every grasp can": ("few", goals.holding(FEW[0], (-0.2, 0.0, 1.25)), 1),
    "one held at a point": ("few", goals.on(FEW[0], "tray") & goals.holding(FEW[1], (-0.3, 0.1, 1.1)), 2),
    "one into a region": ("few", goals.inside(FEW[0], "left"), 1),
    "two into a tray, one held": (
        "few",
        goals.on(FEW[0], "tray") & goals.on(FEW[1], "tray") & goals.holding(FEW[2]),
        3,
    ),
    "swap": ("three", shifted(scene_of("three"), ("a", "b")), 3),
    "cyclic shift": ("three", shifted(scene_of("three"), ("a", "b", "c")), 4),
    "stack of three": ("three", goals.on("b", "a") & goals.on("c", "b"), 2),
    "stack taken down": ("stack", goals.and_(*(goals.on(name, "tray") for name in "abc")), 3),
    "stack turned over": ("stack", goals.on("a", "counter_left") & goals.on("c", "tray") & goals.on("b", "c"), 3),
    "the first support cleared": ("few", goals.clear("table_top"), 4),
    "a stack taken off the first support": ("stack", goals.clear("table_top"), 3),
    "stack moved as it stands": (
        "stack",
        goals.on("a", "counter_left") & goals.on("b", "a") & goals.on("c", "b"),
        5,
    ),
    "stack moved to a point": (
        "stack",
        goals.at("a", (-0.1, 0.72), 0.05) & goals.on("b", "a") & goals.on("c", "b"),
        5,
    ),
    "lower part of a stack moved": ("stack", goals.on("a", "counter_left") & goals.on("b", "a"), 4),
    "one under the top": (
        "stack and one",
        goals.on("a", "table_top") & goals.on("d", "a") & goals.on("c", "d"),
        4,
    ),
    "one above the top": (
        "stack and one",
        goals.on("b", "table_top") & goals.on("c", "b") & goals.on("d", "c"),
        4,
    ),
    "in this order": ("three", goals.inside("a", "left") & goals.inside("c", "left") & goals.before("c", "a"), 2),
}


@cache
def solved(case: str) -> Solution:
    kind, goal, _ = CASES[case]
    found = solve(scene_of(kind), goal)
    assert isinstance(found, Solution), found
    return found


@pytest.mark.parametrize("case", CASES)
def test_a_plan_reaches_its_goal_with_the_fewest_picks(case: str) -> None:
    kind, goal, fewest = CASES[case]
    scene, plan = scene_of(kind), solved(case)
    assert plan.end is not None
    assert plan.bound is not None
    assert goal.holds(plan.end, scene)
    assert not goal.holds(scene)
    assert goal.is_in_order([action.target for action in plan.actions if action.name == "PickUp"])
    assert plan.bound.proved
    assert plan.picks == plan.bound.least == fewest
    assert plan.bound == lower_bound(scene, goal)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [10, 55])
def test_what_is_in_the_way_where_it_is_to_stand_goes_there_last(seed: int) -> None:
    env = gym.make("clutter_env/Rearrange-o8-v0", task="swap")
    env.reset(seed=seed)
    inner: Any = env.unwrapped
    scene = Scene.from_mujoco(inner.model, inner.data, inner.robot, regions=inner.regions)
    plan = solve(scene, inner.goal, time_limit=60)
    assert isinstance(plan, Solution), plan
    assert plan.end is not None
    assert inner.goal.holds(plan.end, scene)


def test_what_waits_for_itself_is_what_is_put_aside() -> None:
    for case in ("one under the top", "one above the top"):
        kind, goal, _ = CASES[case]
        assert lower_bound(scene_of(kind), goal).aside == ("c",)


def test_a_plan_touches_nothing() -> None:
    for case in ("two into a tray, one held", "stack of three"):
        assert_free(solved(case))


def test_what_the_goal_wants_is_put_down_in_general_and_the_rest_for_clearance() -> None:
    plan = solved("swap")
    assert [action.name for action in plan.actions if action.name.startswith("Put")] == [
        "PutDownForClearance",
        "PutDownGeneral",
        "PutDownGeneral",
    ]
    assert len(plan.clearances) == 1
    assert plan.bound is not None
    assert plan.clearances == plan.bound.aside
    assert "Picks: 3; no plan has fewer than 3" in plan.summary()


def test_text_is_the_same_goal(tmp_path: Path) -> None:
    kind, goal, _ = CASES["one into a region"]
    plan = solve(scene_of(kind), goal.to_pddl())
    assert isinstance(plan, Solution)
    assert plan.actions == solved("one into a region").actions
    plan.save(tmp_path / "plan.npz")
    loaded = Solution.load(tmp_path / "plan.npz")
    assert loaded == plan
    assert loaded.goal == goal


def test_a_stranger_leaves_a_region_that_is_to_be_clear_and_nothing_enters_it() -> None:
    scene = scene_of("three")
    place = Region("place", "table_top", (-0.2, 0.0), (0.1, 0.1))
    scene = replace(scene, regions=(place,))
    goal = goals.clear("place")
    plan = solve(scene, goal)
    assert isinstance(plan, Solution)
    assert plan.end is not None
    assert goal.holds(plan.end, scene)
    assert plan.picks == 1


@pytest.mark.parametrize(("around", "fewest"), [(4, 3), pytest.param(5, 4, marks=pytest.mark.slow)])
def test_what_keeps_the_robot_from_putting_an_object_down_is_moved_first_and_counted(around: int, fewest: int) -> None:
    """The object fits between its neighbours, which are taller, the gripper around it does not."""
    places = [(0.085 * np.cos(turn), 0.085 * np.sin(turn)) for turn in np.arange(around) * 2 * np.pi / around]
    ring = [cylinder(f"r{k}", x - 0.1, y, 0.03, 0.2) for k, (x, y) in enumerate(places)]
    scene, goal = table_scene(cylinder("a", -0.2, -0.4, 0.03, 0.1), *ring), goals.at("a", (-0.1, 0.0), 0.003)
    plan, bound = solve(scene, goal), lower_bound(scene, goal)
    assert isinstance(plan, Solution)
    assert plan.end is not None
    assert goal.holds(plan.end, scene)
    assert (plan.picks, bound.picks, bound.proved) == (fewest, fewest, True)


def test_a_goal_of_which_the_bound_proves_that_nothing_reaches_it_is_refused_before_anything_moves() -> None:
    scene = scene_of("stack")
    wide = scene.with_body(replace(scene.body("a"), half_extents=np.array([0.1, 0.1, 0.04])))
    found = solve(wide, goals.on("b", "tray") & goals.on("c", "tray") & goals.on("a", "counter_left"))
    assert isinstance(found, Infeasible)
    assert (found.cause, found.clearances, found.objects) == (Cause.TOO_WIDE, (), ("a",))


def test_what_must_leave_a_place_may_need_others_to_leave_first() -> None:
    near, far = cylinder("near", 0.148, -0.06, 0.031, 0.146), cylinder("far", 0.191, -0.118, 0.028, 0.126)
    scene, goal = (
        table_scene(near, far, cylinder("a", 0.286, 0.285, 0.025, 0.184)),
        goals.at("a", (0.221, -0.076), 0.003),
    )
    plan = solve(scene, goal)
    assert isinstance(plan, Solution)
    assert [action.target for action in plan.actions if action.name == "PickUp"] == ["near", "far", "a"]


def test_what_is_to_be_held_is_put_aside_first_where_it_keeps_another_from_its_place() -> None:
    """The pan's place is free by the shapes alone, so that the bound does not know; the arm does not come to it."""
    *_, scene, goal = drawn_close(49_100_078)
    found = solve(scene, goal)
    assert isinstance(found, Solution)
    assert found.picks == 3
    assert found.end is not None
    assert goal.holds(found.end, scene)


def test_a_pose_in_a_region_for_others_and_a_region_within_another_are_not_kept_free() -> None:
    scene = scene_of("three")
    place = Region("place", "counter_left", (-0.15, 0.72), (0.2, 0.2))
    scene = replace(scene, regions=(*scene.regions, place))
    goal = goals.at("a", (-0.25, 0.62)) & goals.inside("b", "place") & goals.inside("c", "left")
    plan = solve(scene, goal)
    assert isinstance(plan, Solution)
    assert plan.picks == 3


def test_a_plan_that_is_given_up_for_its_put_downs_does_not_say_that_the_time_was_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("planners.tamp.algorithm1.MAX_CLEARANCES", -1)
    found = solve(scene_of("three"), CASES["swap"][1])
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.GIVEN_UP


def test_the_drive_to_an_object_that_cannot_be_lifted_from_there_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    warmup()  # it plans too
    refused: list[GraspCandidate] = []
    pick_up = MotionLayer.pick_up

    def refuse_once(self: MotionLayer, scene: Scene, grasp: GraspCandidate, rises: bool = False) -> Any:
        if not refused:
            refused.append(grasp)
            return NoPath("refused")
        return pick_up(self, scene, grasp, rises)

    monkeypatch.setattr(MotionLayer, "pick_up", refuse_once)
    plan = solve(scene_of("three"), goals.inside("a", "left"))
    assert isinstance(plan, Solution)
    assert plan.stats.replans == 1
    names = [action.name for action in plan.actions]
    assert names == ["MoveBase", "PickUp", "MoveBase", "PutDownGeneral"]
    assert np.allclose(plan.actions[0].trajectory.base[0], scene_of("three").state.base)


def test_what_is_in_the_way_of_the_motion_to_a_place_is_moved_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """No motion leads to the place of `a` as long as `b` stands where it stands."""
    warmup()
    scene, put_down = scene_of("three"), MotionLayer.put_down

    def blocked(self: MotionLayer, now: Scene, placement: Placement, find_blockers: bool = False) -> Any:
        is_there = np.allclose(now.body("b").position, scene.body("b").position, atol=1e-3)
        if is_there and placement.body.name == "a" and placement.body.position[1] > 0.5:
            return BlockedBy(frozenset("b"), "transit") if find_blockers else NoPath("blocked")
        return put_down(self, now, placement, find_blockers)

    monkeypatch.setattr(MotionLayer, "put_down", blocked)
    once = solve(scene, goals.inside("a", "left"), replace(STRATEGIES["lookahead"], attempts=1))
    assert isinstance(once, Solution)
    assert [action.target for action in once.actions if action.name == "PickUp"] == ["a", "b", "a"]
    assert once.stats.history[0].reason == "no motion puts a at its place: b in the way"
    # The next attempt knows that from its first move on.
    plan = solve(scene, goals.inside("a", "left"))
    assert isinstance(plan, Solution)
    assert [action.target for action in plan.actions if action.name == "PickUp"] == ["b", "a"]


def test_a_target_in_the_hand_is_raised_above_what_it_stood_on() -> None:
    """A step on the table: what is in the hand just above it is high above the table."""
    scene, name = scene_of("three"), "a"
    step = StaticObstacle("step", np.array([-0.2, -0.3, HEIGHT + 0.05]), np.array([0.08, 0.08, 0.05]))
    raised = scene.body(name).at(scene.body(name).position + [0.0, 0.0, 0.1])
    scene = replace(
        scene.with_body(raised), static_obstacles=(*scene.static_obstacles, step), supports=(*SIDES, "step")
    )
    plan = solve(scene, name)
    assert isinstance(plan, Solution)
    grip = plan.actions[-1].grip
    assert grip is not None
    in_hand = replace(scene, state=grip[0], held=grip[1])
    for goal in (goals.holding(name), goals.holding(name) & goals.on("b", "table_top")):
        plan = solve(in_hand, goal, time_limit=60)
        assert isinstance(plan, Solution)
        assert plan.end is not None
        assert [action.name for action in plan.actions] == ["MoveBase"]
        assert goal.holds(plan.end, in_hand)


def test_a_goal_that_holds_already_needs_no_plan() -> None:
    plan = solve(scene_of("three"), goals.on("a", "table_top"))
    assert isinstance(plan, Solution)
    assert plan.actions == ()


@pytest.mark.parametrize("name", ["a", "lying"])
def test_what_is_larger_than_its_region_is_refused_by_the_bound(name: str) -> None:
    scene = with_one_lying(0.025)
    goal = goals.inside(name, "place")
    found, bound = solve(scene, goal), lower_bound(scene, goal)
    assert isinstance(found, Infeasible)
    assert f"{name}, however it is put down, is larger than its place" in found.detail
    assert (bound.picks, bound.cause, bound.proved) == (None, found.cause, True)
    long = replace(scene, regions=(Region("place", "table_top", (0.0, -0.15), (0.1, 0.04)),))
    assert lower_bound(long, goal).picks == 1


@pytest.mark.parametrize(("half", "is_refused"), [(0.035, True), (0.09, False)])
def test_what_would_fall_into_a_ring_on_which_it_is_to_stand_is_refused_by_the_bound(
    half: float, is_refused: bool
) -> None:
    """It was let go over the hollow, and the plan ended with it in the air."""
    lid = Body("lid", "box", np.array((half, half, 0.01)), np.array((-0.2, -0.3, HEIGHT + 0.01)), UPRIGHT)
    ring = Body.of_pieces("bowl", bowl().placed[1:])  # without a floor: into a bowl it would be put
    scene = table_scene(lid, ring.at(ring.position + [-0.2, 0.2, HEIGHT - ring.bottom]))
    goal = goals.on("lid", "bowl")
    assert (lower_bound(scene, goal).cause is Cause.NO_CLEARANCE_LOCATION) == is_refused
    if is_refused:
        found = solve(scene, goal)
        assert isinstance(found, Infeasible)
        assert "lid, however it is put down, would fall: what it is to stand on is hollow there" in found.detail
    beside = scene.with_body(lid.at((-0.2, 0.2, HEIGHT + 0.08)))
    whole = goals.on("lid", "bowl") & goals.on("bowl", "table_top")
    assert lower_bound(beside, whole).picks == 0, "what is there is there"


@pytest.mark.parametrize(("middle", "is_refused"), [(-0.38, True), (-0.35, False)])
def test_a_region_in_which_an_object_would_be_beside_the_support_is_refused_by_the_bound(
    middle: float, is_refused: bool
) -> None:
    """It was "given up" without a cause; the front edge of the table is at x = -0.35."""
    scene = replace(scene_of("three"), regions=(Region("over", "table_top", (middle, 0.0), (0.05, 0.05)),))
    for goal in (goals.inside("a", "over"), goals.on("a", "over")):
        assert (lower_bound(scene, goal).cause is Cause.NO_CLEARANCE_LOCATION) == is_refused
        if is_refused:
            found = solve(scene, goal)
            assert isinstance(found, Infeasible)
            assert "a, however it is put down, has its middle beside the support of its region" in found.detail


def test_a_ground_of_any_size_is_a_place() -> None:
    """Of one 10 m wide only points far from the robot were tried."""
    ground = StaticObstacle("ground", np.array([1.0, 2.0, -0.1]), np.array([5.0, 5.0, 0.1]), "box", turned(0.4))
    scene = scene_of("three")
    scene = replace(
        scene, static_obstacles=(*scene.static_obstacles, ground), supports=("table_top", "ground"), regions=()
    )
    plan = solve(scene, goals.on("a", "ground"))
    assert isinstance(plan, Solution), plan
    assert plan.end is not None
    assert abs(plan.end.body("a").bottom) < 0.005
    assert np.abs(plan.end.body("a").position[:2]).max() < 3.0


def turned(yaw: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """R (3, 3) about the vertical."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("is_there", [False, True])
@pytest.mark.parametrize(("apart", "is_refused"), [(0.05, True), (0.068, True), (0.075, False)])
def test_poses_at_which_two_objects_overlap_are_refused_by_the_bound(
    is_there: bool, apart: float, is_refused: bool
) -> None:
    """Both were put aside in turn until the planner gave up; cylinders of 35 mm radius."""
    scene, place = scene_of("three"), np.array([0.0, 0.15])
    scene = scene.with_body(cylinder("a", *place, 0.035, 0.08)) if is_there else scene
    goal = goals.at("a", place, 0.0005) & goals.at("b", place - [apart, 0.0], 0.0005)
    bound = lower_bound(scene, goal)
    assert (bound.picks is None) == is_refused
    if is_refused:
        found = solve(scene, goal)
        assert isinstance(found, Infeasible)
        assert (bound.cause, bound.proved, found.cause) == (Cause.NO_CLEARANCE_LOCATION, True, bound.cause)
        assert "a and b overlap at their poses" in found.detail or "b and a overlap" in found.detail


@pytest.mark.parametrize(("half", "apart", "count"), [(0.05, 0.0, 4), (0.04, 0.02, 2), (0.1, 0.0, 4), (0.045, 0.1, 2)])
def test_what_has_no_room_together_is_refused_by_the_bound(half: float, apart: float, count: int) -> None:
    """In a square of that half side [m], or in two beside each other: the first two cases have no room."""
    mats = tuple(Region(f"mat_{k}", "table_top", (0.05, 0.1 + k * apart), (half, half)) for k in range(2))
    objects = [cylinder(name, -0.25, 0.15 * k - 0.2, 0.03) for k, name in enumerate("abcd")]
    scene = replace(table_scene(*objects), regions=mats)
    goal = goals.and_(*(goals.inside(name, f"mat_{k % 2 if apart else 0}") for k, name in enumerate("abcd"[:count])))
    bound, is_refused = lower_bound(scene, goal), (half, apart) in ((0.05, 0.0), (0.04, 0.02))
    assert bound.picks == (None if is_refused else count)
    if is_refused:
        found = solve(scene, goal)
        assert (found.cause, found.objects, bound.proved) == (Cause.NO_CLEARANCE_LOCATION, bound.objects, True)
        assert "do not all fit where they are to stand: proved, for all grasps" in found.detail


@pytest.mark.parametrize(("sides", "is_refused"), [((0.058, 0.036), True), ((0.12, 0.1), False)])
@pytest.mark.parametrize("mats", ["the same", "turned by 90 degrees", "one contains the others"])
def test_what_has_no_room_together_is_refused_under_several_names_of_its_place(
    sides: tuple[float, float], is_refused: bool, mats: str
) -> None:
    """Any two of the three would fit, but not all."""
    (x, y), grown = sides, 0.001 * (mats == "one contains the others")
    turn = np.pi / 2 if mats == "turned by 90 degrees" else 0.0
    regions = (
        Region("mat_0", "table_top", (0.05, 0.1), (x + grown, y + grown)),
        Region("mat_1", "table_top", (0.05, 0.1), (y, x) if turn else (x, y), turn),
        Region("mat_2", "table_top", (0.05, 0.1), (x, y)),
    )
    objects = [cylinder(name, -0.25, 0.15 * k - 0.2, 0.03) for k, name in enumerate("abc")]
    scene = replace(table_scene(*objects), regions=regions)
    bound = lower_bound(scene, goals.and_(*(goals.inside(name, f"mat_{k}") for k, name in enumerate("abc"))))
    assert bound.picks == (None if is_refused else 3)
    assert set(bound.objects) == set("abc")


def test_an_object_within_the_tolerance_of_its_pose_may_stay_beside_another() -> None:
    """At its very pose it would overlap."""
    place = np.array([0.0, 0.15])
    scene = scene_of("three").with_body(cylinder("a", 0.015, 0.15, 0.035, 0.08))
    assert lower_bound(scene, goals.at("a", place) & goals.at("b", place - [0.065, 0.0])).picks == 1


def with_one_lying(half: float) -> Scene:
    """The scene "three" with a cylinder "lying", and a square place of that half side [m] that is shorter than it."""
    body = cylinder("lying", -0.2, 0.15, 0.03, 0.15)
    lying = body.at([*body.position[:2], HEIGHT + 0.03], np.sqrt(0.5) * np.array([1, 1, 0, 0]))
    place = Region("place", "table_top", (-0.15, -0.15), (half, half))
    return replace(scene_of("three"), objects=(*scene_of("three").objects, lying), regions=(place,))


def test_what_lies_is_stood_up_where_it_does_not_fit_lying() -> None:
    scene, goal = with_one_lying(0.06), goals.inside("lying", "place")
    plan = solve(scene, goal)
    assert isinstance(plan, Solution)
    assert plan.end is not None
    assert plan.picks == 1
    assert plan.end.body("lying").is_upright
    assert goal.holds(plan.end, scene)


def test_an_object_of_pieces_is_put_along_the_sides_of_a_place_that_is_narrower_than_the_circle_around_it() -> None:
    whole = Body("long", "box", np.array((0.06, 0.03, 0.06)), np.array((-0.2, 0.15, HEIGHT + 0.06)), UPRIGHT)
    place = Region("place", "table_top", (-0.15, -0.15), (0.075, 0.045), 0.3)
    scene = replace(scene_of("three"), objects=(*scene_of("three").objects, cut_in_two(whole)), regions=(place,))
    plan = solve(scene, goals.inside("long", "place"))
    assert isinstance(plan, Solution), plan
    assert plan.picks == 1


def nut(position: tuple[float, float, float], turn: float) -> Body:
    """Four walls around a square hole of 45 mm, and a handle of 32 mm; its middle is 18 mm from that of the hole."""
    walls = [(-0.03325, 0.0, 0.0105, 0.04375), (0.03325, 0.0, 0.0105, 0.04375)]
    walls += [(0.0, -0.03325, 0.03125, 0.0105), (0.0, 0.03325, 0.03125, 0.0105), (0.054, 0.0, 0.02525, 0.016)]
    pieces = [
        Solid(f"piece {k}", np.array((x, y, 0.0)), np.array((half_x, half_y, 0.02)))
        for k, (x, y, half_x, half_y) in enumerate(walls)
    ]
    return Body.of_pieces("nut", pieces, position, (np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)))


@pytest.mark.parametrize("turn", [0.0, 2.2])
def test_a_nut_goes_around_its_peg_through_a_grasp_that_fits_there(turn: float) -> None:
    """With a finger in its hole it does not, nor with the hand over the peg."""
    home = (0.412, 0.0, 0.196, 0.0, -2.618, 0.0, 2.942, 0.785)
    arm = replace(robot("panda_mobile").fixed(), home=home)
    table = StaticObstacle("table", np.array((0.0, 0.0, 0.795)), np.array((0.4, 0.4, 0.025)))
    peg = StaticObstacle("peg", np.array((0.23, 0.1, 0.885)), np.array((0.016, 0.016, 0.065)))
    state = RobotState(np.array((-0.73, 0.0, 0.0)), np.array(home), 0.04)
    scene = Scene(arm, state, (nut((-0.1, -0.15, 0.84), turn),), (table, peg), supports=("table",))
    to_hole = float(np.linalg.norm(scene.body("nut").position[:2] - (-0.1, -0.15)))
    wanted = goals.at("nut", (0.23 - to_hole, 0.1, np.pi))
    found = solve(scene, wanted, grasps=(AntipodalFamily("down", np.pi / 2, max_width=0.04),))
    assert isinstance(found, Solution), found
    assert found.end is not None
    assert wanted.holds(found.end, scene)
    assert found.picks == 1
    assert_free(found)


def high_and_low(seed: int) -> Scene:
    """Four objects on a table 0.54 m high, a second one of 0.94 m to its left, both without legs."""
    tables = [
        StaticObstacle(name, np.array([0.0, y, top - 0.02]), np.array([0.35, 0.5, 0.02]))
        for name, y, top in (("table_top", 0.0, 0.54), ("high", 1.6, 0.94))
    ]
    scene = random_scene(4, seed)
    bodies = tuple(one.at(one.position - [0.0, 0.0, HEIGHT - 0.54]) for one in scene.objects)
    return replace(scene, objects=bodies, static_obstacles=tuple(tables), supports=("table_top", "high"))


@pytest.mark.parametrize("stacked", [False, True])
def test_objects_go_straight_to_a_higher_table_over_what_stands_there(stacked: bool) -> None:
    scene = high_and_low(1)
    names = scene.names[:3] if stacked else scene.names
    places = ("high", *names) if stacked else ["high"] * 4
    plan = solve(scene, goals.and_(*(goals.on(*fact) for fact in zip(names, places, strict=False))))
    assert isinstance(plan, Solution), plan
    assert plan.picks == len(names)
    assert_free(plan)


def test_what_has_fallen_is_stood_up_for_a_goal_from_before() -> None:
    fallen, goal = with_one_lying(0.2), goals.inside("lying", "place")
    before = fallen.with_body(cylinder("lying", -0.2, 0.15, 0.03, 0.15))
    for start in (fallen, before):
        plan = Planner(FETCH).solve(fallen, goal, start=start)
        assert isinstance(plan, Solution)
        assert plan.end is not None
        assert goal.holds(plan.end, start)


def test_what_cannot_be_reached_is_refused_by_the_bound() -> None:
    scene = scene_of("three")
    pillar = StaticObstacle("pillar", np.array([3.0, 3.0, 1.5]), np.array([0.1, 0.1, 1.5]))
    high = scene.body("a").at([3.0, 3.0, 3.0 + scene.body("a").half_extents[2]])
    far = replace(scene.with_body(high), static_obstacles=(*scene.static_obstacles, pillar))
    found = solve(far, goals.inside("a", "left"))
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.UNREACHABLE
    assert lower_bound(far, goals.inside("a", "left")).picks is None


def test_a_target_on_an_upper_board_ends_above_where_it_stood() -> None:
    env = gym.make("clutter_env/Retrieve-o15-v0", layout="two_boards", num_objects=16)
    _, info = env.reset(seed=93_500)
    inner: Any = env.unwrapped
    scene = Scene.from_mujoco(inner.model, inner.data, inner.robot)
    plan = solve(scene, info["target"])
    assert isinstance(plan, Solution)
    assert plan.end is not None
    assert goals.holding(info["target"]).holds(plan.end, scene)


ROUND = StaticObstacle("round", np.array([-2.2, 1.3, 0.35]), np.array([0.25, 0.25, 0.35]), "cylinder")


def test_objects_are_put_on_the_face_of_a_round_support_not_beside_it() -> None:
    scene = random_scene(4, 0)
    square = Region("square", "round", (-2.2, 1.3), (0.25, 0.25))
    scene = replace(
        scene,
        static_obstacles=(*scene.static_obstacles, ROUND),
        supports=("table_top", "round"),
        regions=(square,),
    )
    for place in ("round", "square"):
        plan = solve(scene, goals.and_(*(goals.on(name, place) for name in scene.names[:3])))
        assert isinstance(plan, Solution), plan
        assert plan.end is not None
        for name in scene.names[:3]:
            assert np.hypot(*(plan.end.body(name).position - ROUND.position)[:2]) < 0.252 - plan.end.body(name).radius


@pytest.mark.parametrize(("depth", "over_the_edge"), [(0.112, True), (0.12, True), (0.2, False)])
def test_an_object_reaches_over_an_edge_only_if_its_region_does_and_has_no_other_room(
    depth: float, over_the_edge: bool
) -> None:
    region = Region("front", "table_top", (-0.41 + depth / 2, 0.15), (depth / 2, 0.05))
    scene = replace(scene_of("three"), regions=(region,))
    plan = solve(scene, goals.inside("a", "front"))
    assert isinstance(plan, Solution), plan
    assert plan.end is not None
    body = plan.end.body("a")
    inside = body.position[0] - scene.support.outline[:, 0].min()
    assert (inside < body.radius - 0.002) == over_the_edge
    assert inside >= (0.01 if depth < 0.12 else body.radius / 2), "it does not tip"


def test_room_beside_a_static_block_is_found_however_much_of_the_region_that_takes() -> None:
    region = Region("side", "counter_left", (-0.1, 0.75), (0.15, 0.15))
    block = StaticObstacle("block", np.array([-0.1, 0.79, HEIGHT + 0.05]), np.array([0.15, 0.11, 0.05]))
    scene = scene_of("three")
    scene = replace(scene, regions=(region,), static_obstacles=(*scene.static_obstacles, block))
    plan = solve(scene, goals.inside("a", "side"))
    assert isinstance(plan, Solution), plan
    assert plan.picks == 1


@pytest.mark.slow
def test_what_would_tip_over_the_edge_is_not_put_down_and_the_refusal_says_what_is_lacking() -> None:
    goal = goals.at("a", (-0.345, 0.0), 0.003)
    refusal = solve(scene_of("three"), goal)
    assert isinstance(refusal, Infeasible)
    assert f"where {goal} wants it" in refusal.detail


@pytest.mark.parametrize(
    "order",
    [
        goals.inside("b", "left") & goals.on("a", "b") & goals.before("a", "b"),
        goals.inside("b", "left") & goals.holding("a") & goals.before("a", "b"),
        shifted(scene_of("three"), ("a", "b")) & goals.before("a", "b"),
        shifted(scene_of("three"), ("a", "b", "c")) & goals.before("c", "a"),
    ],
)
def test_an_order_that_cannot_be_kept_is_refused_with_a_proof(order: Goal) -> None:
    bound, refusal = lower_bound(scene_of("three"), order), solve(scene_of("three"), order)
    assert bound.picks is None
    assert bound.proved
    assert isinstance(refusal, Infeasible)
    assert "by the order of the goal" in refusal.detail


def test_the_bound_counts_from_the_scene_as_it_is() -> None:
    scene = scene_of("three")
    lying = replace(scene.body("a"), quaternion=np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]))
    scene = scene.with_body(lying.at([*lying.position[:2], HEIGHT + 0.035]))
    goal = goals.on("a", "table_top")
    plan = solve(scene, goal)
    assert isinstance(plan, Solution)
    assert plan.picks == lower_bound(scene, goal).picks == 0


def test_objects_may_have_any_name() -> None:
    scene, names = scene_of("three"), ("goal", "My cup", "aside goal")
    scene = replace(
        scene, objects=tuple(replace(one, name=name) for one, name in zip(scene.objects, names, strict=True))
    )
    goal = Goal.from_pddl(shifted(scene, names[:2]).to_pddl()) & goals.holding("aside goal")
    plan = solve(scene, goal)
    assert isinstance(plan, Solution), plan
    assert plan.picks == lower_bound(scene, goal).picks == 4


def test_no_put_down_strands_the_base() -> None:
    """Behind the table, what the arm has just put down is in its way back; from there every later drive was refuted."""
    it = drawn(49_000_081)
    found = solve(it.scene, it.goal)
    assert isinstance(found, Solution), found
    assert found.end is not None
    assert it.goal.holds(found.end, it.scene)


def reached(scene: Scene, goal: Goal | str) -> Scene:
    """The end of the plan for a goal, which holds there, with as many picks as the bound."""
    settled = Goal.of(goal, scene)
    plan, bound = solve(scene, settled), lower_bound(scene, settled)
    assert isinstance(plan, Solution), plan
    assert plan.end is not None
    assert settled.unmet(plan.end, scene) == ()
    assert (plan.picks, bound.proved) == (bound.picks, True)
    return plan.end


@pytest.mark.parametrize("yaw", [0.0, 0.3, 1.0, 2.0])
def test_a_box_goes_into_a_slot_that_leaves_it_five_millimetres_whatever_its_yaw(yaw: float) -> None:
    box = Body("box", "box", np.array([0.04, 0.02, 0.05]), np.array([-0.2, 0.0, HEIGHT + 0.05]), UPRIGHT)
    slot = Region("slot", "counter_left", (-0.2, 0.72), (0.045, 0.025), yaw)
    reached(replace(table_scene(box), supports=SIDES, regions=(slot,)), goals.inside("box", "slot"))


@pytest.mark.parametrize("apart", [(0.0, 0.06), (0.0, 0.045), (0.03, 0.035), (0.055, 0.0)])
def test_two_whose_poses_overlap_give_way_to_each_other_within_their_tolerances(apart: tuple[float, float]) -> None:
    scene, place = scene_of("three"), np.array([-0.15, 0.70])
    reached(scene, goals.at("a", place, 0.02) & goals.at("b", place + apart, 0.02))


def test_a_pose_under_a_board_is_under_it_for_what_stands_there_also_while_it_is_in_the_hand() -> None:
    scene = shelf_scene(cylinder("a", -0.2, 0.0, 0.035, 0.14))
    scene = replace(scene, supports=("table_top", "counter_left", "shelf_board"))
    end = reached(scene, goals.at("a", (-0.22, 0.2)))
    assert end.body("a").bottom == pytest.approx(HEIGHT, abs=0.005)
    beside = scene.with_body(scene.body("a").at([-0.15, 0.72, HEIGHT + 0.07]))
    for goal, is_above in (
        (goals.at("a", (-0.22, 0.2)), True),
        (goals.at("a", (-0.22, 0.2)) & goals.on("a", "table_top"), False),
    ):
        assert (reached(beside, goal).body("a").bottom > HEIGHT + BOARD_HEIGHT) == is_above


@pytest.mark.parametrize(
    "text",
    [
        "(forall (?x - object) (INSIDE ?x Left))",
        "(and (inside a left) (at a (x -0.15) (y 0.81)))",
        "(and (or (on a tray) (holding b)) (holding c))",
        "(not (exists (?x) (on ?x table_top)))",
    ],
)
def test_a_plan_for_text_that_a_scene_makes_a_goal(text: str) -> None:
    reached(scene_of("three"), text)


@pytest.mark.parametrize(
    ("seed", "least"), [(49_100_066, 5), (49_100_125, 3), (49_100_089, 2)], ids=["boards", "cabinet", "stack"]
)
def test_nothing_is_proved_exact_under_a_shelf_where_no_hand_is_known_to_fit(seed: int, least: int) -> None:
    """No plan with so few picks is known: the bound does not count what keeps a hand from releasing under a board."""
    *_, scene, goal = drawn_close(seed)
    bound = lower_bound(scene, goal)
    assert (bound.picks, bound.least, bound.proved) == (least, least, False)


def test_under_a_shelf_a_bound_is_proved_where_a_hand_fits() -> None:
    scene = shelf_scene(cylinder("a", -0.2, -0.15, 0.027, 0.175), cylinder("b", -0.2, 0.15, 0.027, 0.175))
    assert lower_bound(scene, "a").proved
    assert lower_bound(scene, goals.at("a", (-0.2, 0.0))).proved, "a hand fits beside b"


def test_of_two_bottles_that_change_places_one_is_put_aside() -> None:
    """Of objects of several pieces nothing was proved: two picks, though each stood in the middle of the other's
    place."""
    bodies = [bottle(name, (-0.1, y, HEIGHT)) for name, y in (("object_00", -0.1), ("object_01", 0.1))]
    scene = table_scene(*bodies)
    goal = goals.at("object_00", (-0.1, 0.1)) & goals.at("object_01", (-0.1, -0.1))
    bound, plan = lower_bound(scene, goal), solve(scene, goal)
    assert isinstance(plan, Solution)
    assert (plan.picks, bound.picks, bound.least, bound.proved) == (3, 3, 3, True)


def test_nothing_is_proved_exact_while_something_unproved_stands_at_a_place() -> None:
    """The first bottle stands at the edge of the place of the second one, which fits beside it in no tried yaw."""
    bodies = [bottle(name, (-0.1, y, HEIGHT)) for name, y in (("object_00", 0.066), ("object_01", -0.3))]
    bound = lower_bound(table_scene(*bodies), goals.at("object_01", (-0.1, 0.0), tolerance=0.005))
    assert (bound.picks, bound.least, bound.proved) == (1, 1, False)


def test_a_solve_looks_for_no_hand_that_fits_under_a_shelf(monkeypatch: pytest.MonkeyPatch) -> None:
    """It took half of the time, for a word in the answer: a plan with as many picks as the bound proves it exact."""

    def refuse(*_: object) -> bool:
        raise AssertionError("looked for a hand")

    monkeypatch.setattr("planners.clearing.goal_bound.is_put_down_free", refuse)
    scene = shelf_scene(cylinder("a", -0.2, -0.15, 0.027, 0.175), cylinder("b", -0.2, 0.15, 0.027, 0.175))
    plan = solve(scene, goals.at("a", (-0.2, 0.0)))
    assert isinstance(plan, Solution)
    assert plan.bound is not None
    assert (plan.picks, plan.bound.picks, plan.bound.proved) == (1, 1, True)


def test_a_stack_is_built_where_its_upper_objects_have_room() -> None:
    """The packet went to the back of the table, where the bowl on the can on it would have been in the wall."""
    it = drawn(49_000_119)
    end = reached(it.scene, it.goal)
    assert end.support.position[0] + end.support.extent[0] - end.body("object_01").position[0] > 0.07


def test_what_no_hand_can_release_at_its_place_is_refused_with_a_proof() -> None:
    """A bowl in the corner below a board: the search ran until the time was up."""
    scene, goal = drawn(49_000_124).scene, drawn(49_000_124).goal
    bound = lower_bound(scene, goal)
    assert (bound.picks, bound.objects, bound.proved) == (None, ("object_03",), True)
