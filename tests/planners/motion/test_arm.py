"""Arm paths: free when checked ten times finer; straight lines are straight; objects in the way are named exactly."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from assets.robots import FETCH
from irm.chain import ArmChain
from irm.kinematics import forward
from planners.collision.hit_kernels import edge_samples
from planners.collision.straight_lines import trace_straight
from planners.collision.world import STEP, CollisionWorld
from planners.motion.arm import ArmQuery, plan_arm, tcp_pose, tcp_poses, unwrap_joints
from planners.motion.mujoco_check import TOLERANCE, MujocoCollisionChecker
from planners.motion.path import CLEARANCE, BlockedBy, NoPath, WholeBodyPath, on_base
from planners.motion.rrt import advance
from planners.scene import SELF_BIT, Body, RobotState
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
        opening = 2 * (body.half_width + FETCH.finger_gap)
        for base, q in grasp_configurations(world, body.name, rng) if body.is_upright else []:
            line = trace_straight(world, base, q, UP, 0.19)
            if line is not None and not world.path_hits(on_base(base, line), opening):
                found.append((base, line[-1], opening))
        if len(found) == most:
            break
    return found


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_paths_are_free_when_checked_ten_times_finer(seed: int) -> None:
    world = CollisionWorld.from_scene(mixed_scene(18, seed))
    checker, rng = MujocoCollisionChecker(world.scene), np.random.default_rng(seed)
    goals = hovers(world, rng, 4)
    assert len(goals) == 4
    for base, q, opening in goals:
        path = plan_arm(ArmQuery(world, base, opening), HOME, q, rng=rng)
        assert isinstance(path, WholeBodyPath)
        assert np.allclose(path.configurations[0, 3:], HOME)
        assert np.allclose(pose(base, path.end), pose(base, q))
        assert (path.configurations[:, 3:] >= world.robot.lower - 1e-9).all()
        assert (path.configurations[:, 3:] <= world.robot.upper + 1e-9).all()
        assert checker.deepest_penetration(path, step=STEP / 10).penetration <= TOLERANCE
        assert checker.accepts(path.reversed())


def test_a_path_keeps_room_where_it_can() -> None:
    """A pole that the straight way between two configurations misses by more than 3 mm and less than 8 mm."""
    base, q_start, q_goal = np.array([-1.1, 0.0, 0.0]), HOME.copy(), HOME.copy()
    q_start[1], q_goal[1] = -0.3, 0.3
    straight = on_base(base, np.linspace(q_start, q_goal, 100))
    gripper = pose(base, HOME)[:2, 3]
    for height in np.arange(0.10, 0.50, 0.002):
        world = CollisionWorld.from_scene(table_scene(cylinder("pole", *gripper, height=height)))
        if world.with_padding(0.008).path_hits(straight, 0.1):
            break
    assert not world.with_padding(0.003).path_hits(straight, 0.1)
    path = plan_arm(ArmQuery(world, base, 0.1), q_start, q_goal, rng=np.random.default_rng(0))
    assert isinstance(path, WholeBodyPath)
    assert not world.with_padding(CLEARANCE).path_hits(path.configurations, 0.1)


def test_the_same_generator_gives_the_same_path() -> None:
    world = CollisionWorld.from_scene(mixed_scene(18, 1))
    for base, q, opening in hovers(world, np.random.default_rng(0), 3):
        query = ArmQuery(world, base, opening)
        paths = [plan_arm(query, HOME, q, rng=np.random.default_rng(5)) for _ in range(2)]
        assert np.array_equal(*(path.configurations[:, 3:] for path in paths if isinstance(path, WholeBodyPath)))


def test_straight_lines_are_straight_and_keep_the_gripper_level() -> None:
    world = CollisionWorld.from_scene(mixed_scene(12, 2))
    rng = np.random.default_rng(0)
    lines = 0
    for name in world.scene.names:
        for base, q in grasp_configurations(world, name, rng, count=2):
            line = trace_straight(world, base, q, UP, 0.2)
            if line is None:
                continue
            lines += 1
            start = pose(base, q)
            poses = np.array([pose(base, w) for w in line])
            assert np.allclose(poses[:, :2, 3], start[:2, 3], atol=2e-4)
            assert np.allclose(np.diff(poses[:, 2, 3]), 0.2 / (len(poses) - 1), atol=4e-4)
            assert np.allclose(poses[:, :3, :3], start[:3, :3], atol=3e-3)
            between = [pose(base, (a + b) / 2) for a, b in itertools.pairwise(line)]
            assert np.allclose(np.array(between)[:, :2, 3], start[:2, 3], atol=3e-3)
    assert lines >= 5


def grasp_of_the_first(*objects: Body, seed: int = 1) -> tuple[CollisionWorld, np.ndarray, np.ndarray]:
    """The other objects' world, and a base pose and configuration around the first, which is not there."""
    alone = CollisionWorld.from_scene(table_scene(objects[0]))
    base, q = grasp_configurations(alone, objects[0].name, np.random.default_rng(seed))[0]
    return CollisionWorld.from_scene(table_scene(*objects[1:])), base, q


def beside(x: float, y: float, angle: float, name: str) -> Body:
    return cylinder(name, x + 0.07 * math.cos(angle), y + 0.07 * math.sin(angle))


def line_hits(
    world: CollisionWorld, base: np.ndarray, line: np.ndarray | None, opening: float, ignore: int = 0
) -> tuple[str, ...]:
    """What a straight line hits, by name."""
    assert line is not None
    return world.names_of(world.path_hits(on_base(base, line), opening, ignore=ignore))


def test_a_straight_line_names_exactly_what_it_hits() -> None:
    target, other = cylinder("object_00", -0.15, 0.0), cylinder("object_02", 0.2, 0.35)
    _, base, q = grasp_of_the_first(target)
    forwards = pose(base, q)[:3, 0]
    ahead = beside(-0.15, 0.0, math.atan2(forwards[1], forwards[0]), "object_01")
    world = CollisionWorld.from_scene(table_scene(ahead, other))
    raised = trace_straight(world, base, q, UP, 0.05)
    assert raised is not None
    assert line_hits(world, base, raised, 0.084) == ()
    line = trace_straight(world, base, raised[-1], forwards, 0.05)
    assert line_hits(world, base, line, 0.03) == ("object_01",)
    assert line_hits(world, base, line, 0.03, world.scene.mask(["object_01"])) == ()
    assert "a static obstacle" in line_hits(world, base, trace_straight(world, base, q, -UP, 0.2), 0.084)
    assert trace_straight(world, base, q, UP, 2.0) is None


def test_blockers_are_needed_and_enough() -> None:
    """Planning without the blockers succeeds; with any one of them left it fails."""
    _, base, q = grasp_of_the_first(cylinder("object_00", -0.1, 0.0))
    yaw = math.atan2(pose(base, q)[1, 0], pose(base, q)[0, 0])
    sides = [
        beside(-0.1, 0.0, yaw + turn, name) for turn, name in ((math.pi / 2, "object_01"), (-math.pi / 2, "object_02"))
    ]
    world = CollisionWorld.from_scene(table_scene(*sides, cylinder("object_03", 0.2, 0.35)))
    rng = np.random.default_rng(0)
    query = ArmQuery(world, base, 0.084)
    found = plan_arm(query, HOME, q, rng=rng)
    assert found == BlockedBy(frozenset({"object_01", "object_02"}), "transit")
    enough = world.scene.mask(found.blockers)
    assert isinstance(plan_arm(replace(query, ignore=enough), HOME, q, rng=rng), WholeBodyPath)
    for name in found.blockers:
        fewer = world.scene.mask(found.blockers - {name})
        assert isinstance(plan_arm(replace(query, ignore=fewer), HOME, q, rng=rng), BlockedBy)


def test_where_clearing_cannot_help_there_is_no_path_and_a_reason() -> None:
    world = CollisionWorld.from_scene(mixed_scene(5, 0))
    query, rng = ArmQuery(world, np.array([-0.8, 0.0, 0.0]), 0.08), np.random.default_rng(0)
    found = plan_arm(query, HOME, INTO_TABLE, rng=rng)
    assert isinstance(found, NoPath)
    assert "static obstacle" in found.reason
    found = plan_arm(query, INTO_TABLE, HOME, rng=rng)
    assert isinstance(found, NoPath)
    assert "start" in found.reason


def test_one_of_several_goals_is_enough() -> None:
    world = CollisionWorld.from_scene(mixed_scene(15, 3))
    base, q, opening = hovers(world, np.random.default_rng(2), 1)[0]
    goals, rng = np.stack([INTO_TABLE, q]), np.random.default_rng(0)
    path = plan_arm(ArmQuery(world, base, opening), HOME, goals, rng=rng)
    assert isinstance(path, WholeBodyPath)
    assert np.allclose(pose(base, path.end), pose(base, q))


def test_continuous_joints_take_the_shorter_turn() -> None:
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


def test_tcp_poses_of_many_configurations_are_those_of_each() -> None:
    world, rng = CollisionWorld.from_scene(mixed_scene(3, 0)), np.random.default_rng(0)
    X = np.hstack([rng.normal(size=(40, 3)), rng.uniform(-2, 2, (40, 8))])
    one_by_one = [tcp_pose(FETCH, RobotState(x[:3], x[3:], 0.0)) for x in X]
    assert np.allclose(tcp_poses(world.robot, X), one_by_one, atol=1e-12)


def test_a_robot_near_itself_at_the_start_keeps_away_from_all_else() -> None:
    """No way around was looked for: the robot at home with a long object in hand brushed trays and tables."""
    world, rng = CollisionWorld.from_scene(mixed_scene(18, 2)), np.random.default_rng(2)
    wide, found = world.with_padding(CLEARANCE), list[bool]()
    for base, q, opening in hovers(world, rng, 3):
        if wide.hits(base, q, opening) & ~(1 << SELF_BIT):
            continue
        Q = np.clip(HOME + rng.normal(0, 0.5, (400, 8)), world.robot.lower, world.robot.upper)
        free, near = world.hits_many(base, Q, opening) == 0, wide.hits_many(base, Q, opening) == 1 << SELF_BIT
        for start in Q[free & near][:5]:
            path = plan_arm(ArmQuery(world, base, opening), start, q, rng=np.random.default_rng(0))
            assert isinstance(path, WholeBodyPath)
            assert not world.path_hits(path.configurations, opening)
            found.append(not wide.path_hits(path.configurations, opening, None, 1 << SELF_BIT))
    assert len(found) >= 10
    assert np.mean(found) > 0.9


@pytest.mark.parametrize("first_step", [0.004, 0.02])
def test_a_tree_grows_as_far_as_if_each_step_were_checked(first_step: float) -> None:
    """The slow twin checks one step after another."""
    world, rng, outcomes = CollisionWorld.from_scene(mixed_scene(18, 0)), np.random.default_rng(0), []
    query = world.query(0.1, first_only=True)
    free = [x for base, q, _ in hovers(world, rng, 6) for x in (np.append(base, q),) if not world.hits(base, q, 0.1)]
    for start in free * 8:
        target = start + np.append(np.zeros(3), rng.normal(0.0, 0.4, len(HOME)))
        parts, reached, expected = edge_samples(query.attached.reach, start, target, first_step), start.copy(), 2
        for i in range(1, parts + 1):
            x = start + (target - start) * i / parts
            if world.hits(x[:3], x[3:], 0.1):
                expected = 1 if i > 3 else 0
                break
            reached = x
        found = np.empty(len(start))
        outcomes.append(advance(query, start, target, first_step, found))
        assert outcomes[-1] == expected
        np.testing.assert_array_equal(found, reached)
    assert {1, 2} <= set(outcomes)
