"""Robots whose base does not move: plans keep it where it stands, and refusals say that it cannot move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from assets import FETCH, InvalidRobot, RobotSpec, robot
from planners import BoundAction, Cause, Infeasible, Solution, clearance_floor, solve
from planners.collision.world import CollisionWorld
from planners.goals import Region
from planners.motion.base import plan_base
from planners.motion.mujoco_check import MujocoCollisionChecker
from planners.motion.path import NoPath, WholeBodyPath
from planners.scene import RobotState, Scene, StaticObstacle
from planners.scene.cover import is_covered
from planners.warming import warmup_scene
from tests.planners.scenes import cylinder

PANDA = robot("panda_mobile").fixed()
SCENE = warmup_scene(PANDA)


def moved(scene: Scene, x: float) -> Scene:
    """The scene with the robot farther from the table by x [m]."""
    state = scene.state
    return scene.with_state(RobotState(state.base - [x, 0.0, 0.0], state.q, state.finger_position))


def stays(action: BoundAction, scene: Scene) -> bool:
    """Whether the base is where it stands all the time, but for rounding."""
    return bool(np.abs(action.trajectory.base - scene.state.base).max() < 1e-12)


@pytest.mark.parametrize("grasps", ["side", "all"])
def test_the_base_stays_and_the_minimum_is_cleared(grasps: str) -> None:
    found = solve(SCENE, "object_00", grasps=grasps)
    assert isinstance(found, Solution), found
    for action in found.actions:
        assert stays(action, SCENE)
        assert MujocoCollisionChecker(action.scene).accepts(action.trajectory)
    floor = clearance_floor(SCENE, "object_00", grasps=grasps)
    assert floor.proved
    assert len(found.clearances) == floor.count


def test_goals_with_places_are_reached_from_where_it_stands() -> None:
    scene = replace(SCENE, regions=(Region("left", "table_top", (0.05, 0.35), (0.15, 0.1)),))
    found = solve(scene, "(and (inside object_01 left) (holding object_04))")
    assert isinstance(found, Solution), found
    assert all(stays(action, SCENE) for action in found.actions)


def test_what_is_out_of_reach_is_refused_with_a_proof() -> None:
    found = solve(moved(SCENE, 0.6), "object_00")
    assert isinstance(found, Infeasible)
    assert found.cause == Cause.UNREACHABLE
    assert "the base cannot move" in found.detail
    assert "proved" in found.detail


def test_what_is_in_reach_of_the_joints_alone_is_refused_without_that_proof() -> None:
    box = StaticObstacle("lid", np.array([0.25, 0.0, 0.95]), np.array([0.1, 0.1, 0.1]))
    around = [
        StaticObstacle(
            f"side_{k}", np.array([0.25 + x, y, 0.85]), np.array([0.01 + abs(y) / 2, 0.01 + abs(x) / 2, 0.1])
        )
        for k, (x, y) in enumerate([(-0.06, 0.0), (0.06, 0.0), (0.0, 0.06), (0.0, -0.06)])
    ]
    scene = replace(SCENE, objects=SCENE.objects[:1], static_obstacles=(*SCENE.static_obstacles, box, *around))
    found = solve(scene, "object_00")
    assert isinstance(found, Infeasible)
    assert "the base cannot move" in found.detail
    assert "proved" not in found.detail


def test_under_a_board_the_arm_reaches_in() -> None:
    board = StaticObstacle("board", np.array([0.2, 0.0, 1.15]), np.array([0.15, 0.5, 0.01]))
    scene = replace(
        SCENE,
        objects=(cylinder("can", 0.08, 0.0, height=0.12),),
        static_obstacles=(*SCENE.static_obstacles, board),
    )
    assert is_covered(scene, scene.body("can").foot)
    found = solve(scene, "can", grasps="side")
    assert isinstance(found, Solution), found
    assert all(stays(action, scene) for action in found.actions)


def test_a_drive_to_elsewhere_is_refused_and_none_is_free() -> None:
    world, here = CollisionWorld.from_scene(SCENE), SCENE.state.base
    assert plan_base(world, here, here + [0.1, 0.0, 0.0], PANDA.home) == NoPath("the base cannot move")
    stays = plan_base(world, here, here, PANDA.home)
    assert isinstance(stays, WholeBodyPath)
    assert (stays.configurations[:, :3] == here).all()


def test_what_the_base_stands_in_does_not_count_but_to_the_arm() -> None:
    plinth = StaticObstacle("plinth", np.array([*SCENE.state.base[:2], 0.15]), np.array([0.3, 0.3, 0.15]))
    scene = replace(SCENE, static_obstacles=(*SCENE.static_obstacles, plinth))
    found = solve(scene, "object_00")
    assert isinstance(found, Solution), found
    assert all(MujocoCollisionChecker(action.scene).accepts(action.trajectory) for action in found.actions)
    high = replace(plinth, position=np.array([*SCENE.state.base[:2], 0.7]), half_extents=np.array([0.3, 0.3, 0.7]))
    world = CollisionWorld.from_scene(replace(SCENE, static_obstacles=(*SCENE.static_obstacles, high)))
    assert world.names_of(world.hits(SCENE.state.base, PANDA.home, 0.0)) == ("a static obstacle",)
    drives = CollisionWorld.from_scene(replace(scene, robot=robot("panda_mobile")))
    assert drives.names_of(drives.hits(SCENE.state.base, PANDA.home, 0.0)) == ("a static obstacle",)


def test_a_robot_is_fixed_by_a_method_or_by_its_page() -> None:
    assert FETCH.fixed().base_drive == "fixed"
    assert FETCH.fixed() != FETCH
    page = {"base_joints": PANDA.base_joints, "tip": "tcp", "finger_joints": PANDA.finger_joints, "home": PANDA.home}
    assert RobotSpec.from_mjcf(PANDA.mjcf, base="fixed", **page).base_drive == "fixed"
    with pytest.raises(InvalidRobot, match="'holonomic', 'differential', 'fixed', not 'floating'"):
        RobotSpec.from_mjcf(PANDA.mjcf, base="floating", **page)
