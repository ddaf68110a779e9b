"""Whole solves on scenes without simulation: plans that can be carried out, and honest refusals."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from assets.robots import FETCH, UnknownRobot
from planners import Infeasible, Planner, Scene, Solution, clearance_floor, solve
from planners.cause import Cause
from planners.clearing.commitments import grasped
from planners.motion.arm import tcp_pose
from planners.motion.mujoco_check import MujocoCollisionChecker
from planners.scene import RobotState, SceneError, UnknownObject
from planners.strategies import STRATEGIES, StrategyError, UnknownStrategy
from planners.tamp.solution import SolveStats
from tests.planners.scenes import cylinder, random_scene, table_scene

PLANNER = Planner(FETCH, grasps="side")


def obstructed(count: int, seed: int) -> tuple[Scene, str]:
    """A random scene and an object in it that cannot be taken without clearing another one."""
    scene = random_scene(count, seed)
    for name in scene.names:
        if PLANNER.clearance_floor(scene, name).count:
            return scene, name
    raise AssertionError("no obstructed object in this scene")


@pytest.fixture(scope="module")
def problem() -> tuple[Scene, str]:
    return obstructed(25, 3)


@pytest.fixture(scope="module")
def plan(problem: tuple[Scene, str]) -> Solution:
    """The plan of `lookahead`."""
    found = PLANNER.solve(*problem, rng=np.random.default_rng(0))
    assert isinstance(found, Solution)
    return found


@pytest.mark.parametrize(
    "strategy", [pytest.param(name, marks=pytest.mark.slow) if name == "srivastava" else name for name in STRATEGIES]
)
def test_a_plan_takes_and_puts_in_turn_and_ends_with_the_target(strategy: str, problem: tuple[Scene, str]) -> None:
    scene, target = problem
    found = PLANNER.solve(scene, target, strategy, np.random.default_rng(0))
    assert isinstance(found, Solution), found
    gripper_poses = [action for action in found.actions if action.name != "MoveBase"]
    assert gripper_poses[-1].name == "PickUp"
    assert gripper_poses[-1].target == target
    for taken, put in zip(gripper_poses[:-1:2], gripper_poses[1:-1:2], strict=True):
        assert taken.name == "PickUp"
        assert put.name == "PutDownForClearance"
        assert taken.target == put.target
    assert found.clearances == tuple(put.target for put in gripper_poses[1:-1:2])


def test_trajectories_join(plan: Solution) -> None:
    for before, after in itertools.pairwise(plan.actions):
        one, other = before.trajectory, after.trajectory
        assert np.allclose(one.base[-1], other.base[0], atol=1e-6)
        assert np.allclose(one.q[-1], other.q[0], atol=1e-6)
        assert one.finger_position[-1] == pytest.approx(other.finger_position[0])


def test_lookahead_meets_the_lower_bound_and_clears_nothing_twice(problem: tuple[Scene, str], plan: Solution) -> None:
    bound = clearance_floor(*problem, grasps="side")
    assert bound.proved
    assert bound.count is not None
    assert bound.count <= len(plan.clearances) <= bound.count + 1
    assert plan.duplicated == ()


def test_mujoco_finds_no_deep_penetration_at_a_finer_step(problem: tuple[Scene, str], plan: Solution) -> None:
    first = [action for action in plan.actions if action.name in ("MoveBase", "PickUp")][:2]
    checker = MujocoCollisionChecker(problem[0])
    for action in first:
        assert checker.deepest_penetration(action.trajectory, step=0.002).penetration <= 0.001


def test_the_same_generator_gives_the_same_plan(problem: tuple[Scene, str], plan: Solution) -> None:
    again = PLANNER.solve(*problem, rng=np.random.default_rng(0))
    assert replace(plan, stats=SolveStats()) == replace(again, stats=SolveStats())


def test_an_object_in_hand_is_put_down_first() -> None:
    scene = table_scene(cylinder("object_00", -0.2, 0.2), cylinder("object_01", 0.0, -0.2))
    first = PLANNER.solve(scene, "object_00")
    assert isinstance(first, Solution)
    candidates = PLANNER.workspace(scene).grasps()
    in_hand = grasped(scene, candidates.for_object(scene, "object_00")[0])
    found = PLANNER.solve(in_hand, "object_01")
    assert isinstance(found, Solution), found
    assert [action.name for action in found.actions if action.name != "MoveBase"] == ["PutDownForClearance", "PickUp"]
    nothing_to_do = PLANNER.solve(in_hand, "object_00")
    assert isinstance(nothing_to_do, Solution)
    assert nothing_to_do.actions == ()


def test_a_target_that_is_held_low_is_brought_up() -> None:
    """An arm that stopped on its way home held the target lower than counts as lifted, and the plan was empty."""
    scene = table_scene(cylinder("object_00", -0.2, 0.2), cylinder("object_01", 0.0, -0.2))
    grasp = PLANNER.workspace(scene).grasps().for_object(scene, "object_00")[0]
    low = np.array([grasp.q[0] + 0.02, *grasp.q[1:]])
    in_hand = grasped(scene, grasp).with_state(RobotState(grasp.base, low, 0.0))
    found = PLANNER.solve(in_hand, "object_00")
    assert isinstance(found, Solution)
    assert [action.name for action in found.actions] == ["MoveBase"]
    end = found.actions[-1].trajectory
    assert np.allclose(end.base[-1], grasp.base)
    held, T_world_tcp = in_hand.held, tcp_pose(FETCH, RobotState(end.base[-1], end.q[-1], 0.0))
    assert held is not None
    raised = scene.body("object_00").at_pose(T_world_tcp @ held.T_tcp_object)
    assert raised.bottom - scene.body("object_00").bottom > 0.1


def test_misuse_is_answered_by_what_is_valid() -> None:
    scene: Any = table_scene(cylinder("object_00", 0.0, 0.0))
    for ask in (solve, clearance_floor):
        with pytest.raises(UnknownObject, match="object_00"):
            ask(scene, "object_07")
        with pytest.raises(SceneError, match=r"Scene\.from_mujoco"):
            ask(SimpleNamespace(robot=FETCH), "object_00")
    with pytest.raises(UnknownStrategy, match="lookahead"):
        solve(scene, "object_00", strategy="magic")
    with pytest.raises(StrategyError, match=r"no field 'second_moves'; fields: name, grasps"):
        replace(STRATEGIES["lookahead"], second_moves=2)
    assert Planner("fetch").robot is FETCH  # type: ignore[arg-type]  # a name is accepted, the robot is kept
    with pytest.raises(UnknownRobot, match="fetch"):
        Planner("fetsch")  # type: ignore[arg-type]  # likewise


def test_a_seed_is_a_generator_and_a_start_is_a_scene() -> None:
    """`rng=3` and `start="x"` ended in an AttributeError."""
    scene, planner = random_scene(4, 0), Planner(FETCH)
    one, other = (planner.solve(scene, "object_00", rng=rng) for rng in (3, np.random.default_rng(3)))
    assert isinstance(one, Solution)
    assert isinstance(other, Solution)
    assert one.actions == other.actions
    with pytest.raises(SceneError, match="is no Scene"):
        planner.solve(scene, "object_00", start="x")  # type: ignore[arg-type]  # on purpose


def test_overlapping_objects_are_named() -> None:
    scene = table_scene(cylinder("object_00", 0.0, 0.0), cylinder("object_01", 0.02, 0.0))
    with pytest.raises(SceneError, match="object_00 and object_01"):
        solve(scene, "object_00")


def test_a_robot_inside_the_table_is_refused() -> None:
    scene = table_scene(cylinder("object_00", 0.0, 0.0))
    inside = scene.with_state(RobotState(np.array([0.0, 0.8, 0.0]), scene.state.q, 0.0))
    with pytest.raises(SceneError, match="is inside"):
        solve(inside, "object_00")


def test_an_object_on_the_floor_behind_the_table_is_unreachable() -> None:
    body = cylinder("object_00", 0.0, 0.0).at((0.2, 0.0, 0.08))
    found = solve(table_scene(body), "object_00")
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.UNREACHABLE
    assert "object_00" in found.detail


def test_objects_that_block_each_other_from_everywhere_are_named_as_such() -> None:
    """Cylinders half a millimetre apart: no finger fits between any two of them, so that none can be the first."""
    places = [(x, y) for x in 0.0705 * np.arange(-2, 3) for y in 0.0705 * np.arange(-2, 3)]
    objects = [cylinder(f"object_{i:02d}", x, y, radius=0.035, height=0.2) for i, (x, y) in enumerate(places)]
    scene = table_scene(*objects)
    found = solve(scene, "object_12", time_limit=20.0, grasps="side")
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.NO_SELF_CLEARABLE_SET
    assert clearance_floor(scene, "object_12", grasps="side").count is None
