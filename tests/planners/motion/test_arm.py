"""Arm motions: free when checked ten times finer, straight where promised, honest about what is in the way."""

from __future__ import annotations

import math

import numpy as np
import pytest

from assets.robots import FETCH
from irm.arm.kinematics import ArmChain, forward
from planners.collision.world import STEP, CollisionWorld
from planners.motion.approaches import SIDE_CLEARANCE
from planners.motion.arm import (
    ArmPath,
    BlockedBy,
    NoPath,
    RRTConfig,
    plan_arm,
    tcp_pose,
    unwrap_joints,
)
from planners.motion.mujoco_check import TOLERANCE, MujocoCollisionChecker
from planners.motion.straight_lines import plan_straight
from planners.scene import Body, RobotState
from tests.planners.motion_scenes import grasp_configurations, mixed_scene
from tests.planners.scenes import cylinder, table_scene

HOME = np.array(FETCH.home)
INTO_TABLE = np.array([0.05, 0.0, 1.3, 0.0, 0.3, 0.0, 0.0, 0.0])
UP = np.array([0.0, 0.0, 1.0])


def pose(base: np.ndarray, q: np.ndarray) -> np.ndarray:
    return tcp_pose(FETCH, RobotState(base, q, 0.0))


def hovers(world: CollisionWorld, rng: np.random.Generator, most: int) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Base poses, configurations above grasps of standing objects, and gripper openings [m]."""
    found = []
    for body in world.scene.objects:
        opening = 2 * (body.half_width + SIDE_CLEARANCE)
        for base, q in grasp_configurations(world, body.name, rng) if body.is_upright else []:
            line = plan_straight(world, base, q, UP, 0.19, opening)
            if isinstance(line, ArmPath):
                found.append((base, line.end, opening))
        if len(found) == most:
            break
    return found


@pytest.mark.parametrize("seed", range(3))
def test_paths_are_free_when_checked_ten_times_finer(seed: int) -> None:
    world = CollisionWorld.from_scene(mixed_scene(18, seed))
    checker, rng = MujocoCollisionChecker(world.scene), np.random.default_rng(seed)
    goals = hovers(world, rng, 4)
    assert len(goals) == 4
    for base, q, opening in goals:
        path = plan_arm(world, base, HOME, q, opening, rng=rng)
        assert isinstance(path, ArmPath)
        assert np.allclose(path.start, HOME)
        assert np.allclose(pose(base, path.end), pose(base, q))
        assert (path.waypoints >= world.robot.lower - 1e-9).all()
        assert (path.waypoints <= world.robot.upper + 1e-9).all()
        assert checker.deepest_penetration(path, step=STEP / 10).penetration <= TOLERANCE
        assert checker.accepts(path.reversed())


def test_the_same_generator_gives_the_same_path() -> None:
    world = CollisionWorld.from_scene(mixed_scene(18, 1))
    for base, q, opening in hovers(world, np.random.default_rng(0), 3):
        paths = [plan_arm(world, base, HOME, q, opening, rng=np.random.default_rng(5)) for _ in range(2)]
        assert np.array_equal(*(path.waypoints for path in paths if isinstance(path, ArmPath)))


def test_straight_lines_are_straight_and_keep_the_hand_level() -> None:
    world = CollisionWorld.from_scene(mixed_scene(12, 2))
    rng = np.random.default_rng(0)
    lines = 0
    for name in world.scene.names:
        for base, q in grasp_configurations(world, name, rng, count=2):
            line = plan_straight(world, base, q, UP, 0.2, 0.09)
            if not isinstance(line, ArmPath):
                continue
            lines += 1
            start = pose(base, q)
            poses = np.array([pose(base, w) for w in line.waypoints])
            assert np.allclose(poses[:, :2, 3], start[:2, 3], atol=2e-4)
            assert np.allclose(np.diff(poses[:, 2, 3]), 0.2 / (len(poses) - 1), atol=4e-4)
            assert np.allclose(poses[:, :3, :3], start[:3, :3], atol=3e-3)
            between = [pose(base, (a + b) / 2) for a, b in zip(line.waypoints[:-1], line.waypoints[1:], strict=True)]
            assert np.allclose(np.array(between)[:, :2, 3], start[:2, 3], atol=3e-3)
    assert lines >= 5


def grasp_of_the_first(*objects: Body, seed: int = 1) -> tuple[CollisionWorld, np.ndarray, np.ndarray]:
    """The other objects' world, and a base pose and configuration around the first, which is not there."""
    alone = CollisionWorld.from_scene(table_scene(objects[0]))
    base, q = grasp_configurations(alone, objects[0].name, np.random.default_rng(seed))[0]
    return CollisionWorld.from_scene(table_scene(*objects[1:])), base, q


def beside(x: float, y: float, angle: float, name: str) -> Body:
    return cylinder(name, x + 0.07 * math.cos(angle), y + 0.07 * math.sin(angle))


def test_a_straight_line_names_exactly_what_it_hits() -> None:
    target, other = cylinder("object_00", -0.15, 0.0), cylinder("object_02", 0.2, 0.35)
    _, base, q = grasp_of_the_first(target)
    forwards = pose(base, q)[:3, 0]
    ahead = beside(-0.15, 0.0, math.atan2(forwards[1], forwards[0]), "object_01")
    world = CollisionWorld.from_scene(table_scene(ahead, other))
    raised = plan_straight(world, base, q, UP, 0.05, 0.084)
    assert isinstance(raised, ArmPath)
    found = plan_straight(world, base, raised.end, forwards, 0.05, 0.03)
    assert found == BlockedBy(frozenset({"object_01"}), "approach")
    ignore = world.scene.mask(["object_01"])
    assert isinstance(plan_straight(world, base, raised.end, forwards, 0.05, 0.03, ignore=ignore), ArmPath)
    assert isinstance(plan_straight(world, base, q, -UP, 0.2, 0.084), NoPath)
    assert isinstance(plan_straight(world, base, q, UP, 2.0, 0.084), NoPath)


def test_blamed_objects_are_needed_and_enough() -> None:
    """Planning without the blamed ones succeeds, without any fewer it fails."""
    _, base, q = grasp_of_the_first(cylinder("object_00", -0.1, 0.0))
    yaw = math.atan2(pose(base, q)[1, 0], pose(base, q)[0, 0])
    sides = [
        beside(-0.1, 0.0, yaw + turn, name) for turn, name in ((math.pi / 2, "object_01"), (-math.pi / 2, "object_02"))
    ]
    world = CollisionWorld.from_scene(table_scene(*sides, cylinder("object_03", 0.2, 0.35)))
    rng = np.random.default_rng(0)
    found = plan_arm(world, base, HOME, q, 0.084, rng=rng)
    assert found == BlockedBy(frozenset({"object_01", "object_02"}), "transit")
    enough = world.scene.mask(found.blockers)
    assert isinstance(plan_arm(world, base, HOME, q, 0.084, ignore=enough, rng=rng), ArmPath)
    for name in found.blockers:
        fewer = world.scene.mask(found.blockers - {name})
        assert isinstance(plan_arm(world, base, HOME, q, 0.084, ignore=fewer, rng=rng), BlockedBy)


def test_what_clearing_cannot_help_is_unreachable_and_says_why() -> None:
    world = CollisionWorld.from_scene(mixed_scene(5, 0))
    base, rng = np.array([-0.8, 0.0, 0.0]), np.random.default_rng(0)
    found = plan_arm(world, base, HOME, INTO_TABLE, 0.08, rng=rng)
    assert isinstance(found, NoPath)
    assert "static obstacle" in found.reason
    found = plan_arm(world, base, INTO_TABLE, HOME, 0.08, rng=rng)
    assert isinstance(found, NoPath)
    assert "start" in found.reason


def test_one_of_several_goals_is_enough() -> None:
    world = CollisionWorld.from_scene(mixed_scene(15, 3))
    base, q, opening = hovers(world, np.random.default_rng(2), 1)[0]
    path = plan_arm(world, base, HOME, np.stack([INTO_TABLE, q]), opening, rng=np.random.default_rng(0))
    assert isinstance(path, ArmPath)
    assert np.allclose(pose(base, path.end), pose(base, q))


def test_turning_joints_take_the_short_way() -> None:
    robot = CollisionWorld.from_scene(table_scene()).robot
    rng = np.random.default_rng(0)
    chain = ArmChain.from_robot(FETCH)
    for _ in range(50):
        q, goal = rng.uniform(robot.lower, robot.upper, (2, 8))
        turned = unwrap_joints(robot, q, goal)
        assert np.allclose(forward(chain, turned), forward(chain, goal))
        assert (np.abs(turned - q) <= np.abs(goal - q) + 1e-9).all()
        assert (turned >= robot.lower).all()
        assert (turned <= robot.upper).all()


def test_effort_is_bounded() -> None:
    """A search that may not search still answers, with a path that needs none or with the reason."""
    world = CollisionWorld.from_scene(mixed_scene(18, 2))
    for base, q, opening in hovers(world, np.random.default_rng(1), 3):
        found = plan_arm(world, base, HOME, q, opening, rng=np.random.default_rng(0), config=RRTConfig(iterations=0))
        assert isinstance(found, ArmPath | BlockedBy | NoPath)
