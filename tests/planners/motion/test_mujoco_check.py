"""MuJoCo's collision check: what it finds, what it ignores on purpose, and that it can be used again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from assets.robots import FETCH
from planners.collision.hit_kernels import unproved_states
from planners.collision.world import CollisionWorld
from planners.motion import mujoco_check
from planners.motion.arm import tcp_pose
from planners.motion.mujoco_check import TOLERANCE, MujocoCollisionChecker, PenetrationReport
from planners.motion.path import WholeBodyPath, interpolate
from planners.motion.pick_and_place import PickPlaceMotion, plan_pick
from planners.motion.timing import pick_trajectory
from planners.motion.trajectory import Phase, Trajectory
from planners.scene import HeldObject, RobotState, Scene, SceneError
from tests.planners.motion_scenes import arm_path, grasp_configurations, mixed_scene
from tests.planners.scenes import cylinder, table_scene

HOME = np.array(FETCH.home)
BASE = np.array([-1.1, 0.0, 0.0])


def tcp_at_home(base: np.ndarray) -> np.ndarray:
    """T_world_tcp (4, 4)."""
    return tcp_pose(FETCH, RobotState(base, HOME, 0.0))


def scene_with_a_post(depth: float) -> Scene:
    """A post whose near side is `depth` [m] behind the front of the right finger at home, and an object aside."""
    tip = tcp_at_home(BASE)[:3, 3] + [0.0385 - 0.015, 0.0, 0.0]
    radius, height = 0.03, 0.4
    post = cylinder("object_00", tip[0] + radius - depth, tip[1] - 0.008, radius, height)
    return table_scene(post, cylinder("object_01", 0.2, 0.3))


@pytest.mark.parametrize("depth", [-0.002, 0.002, 0.006])
def test_depth_is_measured_and_the_pair_is_named(depth: float) -> None:
    checker = MujocoCollisionChecker(scene_with_a_post(depth))
    path = arm_path(BASE, HOME[None], 0.0)
    report = checker.deepest_penetration(path)
    if depth < 0:
        assert report.penetration == 0.0
        assert checker.accepts(path)
    else:
        assert report.penetration == pytest.approx(depth, abs=1e-3)
        assert "object_00" in report.pair
        assert not checker.accepts(path)
        assert checker.accepts(arm_path(BASE, HOME[None], 0.0, ignore=1))


def test_a_collision_between_waypoints_is_seen() -> None:
    checker = MujocoCollisionChecker(mixed_scene(10, 0))
    away, through = HOME.copy(), HOME.copy()
    away[1], through[1] = 1.5, -1.5
    lowered = np.stack([away, through]) + np.array([0, 0, 1.0, 0, 0, 0, 0, 0])
    base = np.array([-0.75, 0.0, 0.0])
    ends = [checker.deepest_penetration(arm_path(base, q[None], 0.05)).penetration for q in lowered]
    assert checker.deepest_penetration(arm_path(base, lowered, 0.05)).penetration > max(ends)


def test_the_robot_collides_with_itself_but_neighbours_may_touch() -> None:
    checker = MujocoCollisionChecker(table_scene())
    folded = np.array([0.1, 0.0, -1.2, 0.0, 2.25, 0.0, 1.9, 0.0])
    into_head = arm_path(np.array([-1.5, 0, 0]), folded[None], 0.05)
    into_torso = arm_path(np.array([-1.5, 0, 0]), np.array([[0.05, 1.6, 1.5, 0.0, 2.2, 0.0, 2.0, 0.0]]), 0.05)
    assert (
        max(checker.deepest_penetration(into_head).penetration, checker.deepest_penetration(into_torso).penetration)
        > 0.01
    )
    assert checker.deepest_penetration(arm_path(BASE, HOME[None], 0.1)).penetration == 0.0


def test_a_held_object_collides_with_others_but_not_with_the_gripper() -> None:
    tcp = tcp_at_home(BASE)[:3, 3]
    far, near = (cylinder("object_00", tcp[0] + gap, tcp[1], 0.03, 0.4) for gap in (0.08, 0.05))
    held = HeldObject("object_01", np.eye(4))
    path = arm_path(BASE, HOME[None], 0.0, held)
    other = cylinder("object_01", 0.2, 0.3)
    assert MujocoCollisionChecker(table_scene(far, other)).accepts(path)
    report = MujocoCollisionChecker(table_scene(near, other)).deepest_penetration(path)
    assert set(report.pair) == {"object_00", "object_01"}
    assert report.penetration == pytest.approx(0.01, abs=1e-3)


def test_a_check_does_not_change_the_next_one() -> None:
    scene = mixed_scene(10, 1)
    checker = MujocoCollisionChecker(scene)
    empty = arm_path(np.array([-0.8, 0.0, 0.0]), np.stack([HOME, HOME + 0.3]), 0.05)
    loaded = arm_path(
        empty.configurations[0, :3], empty.configurations[:, 3:], 0.05, HeldObject("object_02", np.eye(4))
    )
    first = checker.deepest_penetration(empty)
    checker.deepest_penetration(loaded)
    assert checker.deepest_penetration(empty).penetration == first.penetration


def test_moving_to_another_scene_equals_building_anew() -> None:
    scene = mixed_scene(12, 2)
    moved = scene.with_body(scene.body("object_00").at([-0.45, 0.45, 1.05]))
    path = arm_path(np.array([-1.1, 0.0, 0.0]), HOME[None], 0.05)
    checker = MujocoCollisionChecker(scene)
    before = checker.deepest_penetration(path).penetration
    checker.move_to(moved)
    assert (
        checker.deepest_penetration(path).penetration
        == MujocoCollisionChecker(moved).deepest_penetration(path).penetration
        != before
    )
    with pytest.raises(SceneError, match="same robot"):
        checker.move_to(mixed_scene(11, 2))


def test_a_trajectory_is_checked_with_the_object_held_at_the_time() -> None:
    scene = table_scene(cylinder("object_00", -0.15, 0.0), cylinder("object_01", 0.1, 0.3))
    world, rng = CollisionWorld.from_scene(scene), np.random.default_rng(0)
    base, q = grasp_configurations(world, "object_00", rng)[0]
    motion = plan_pick(world, base, HOME, q, "object_00", rng=rng)
    assert isinstance(motion, PickPlaceMotion)
    state = RobotState(base, HOME, FETCH.max_finger_position)
    trajectory = pick_trajectory(world, motion, state)
    checker = MujocoCollisionChecker(scene)
    assert checker.accepts(trajectory, step=0.002)
    unaware = Trajectory(
        trajectory.times, trajectory.base, trajectory.q, trajectory.finger_position, (Phase("empty", 0.0),)
    )
    assert not checker.accepts(unaware)


@pytest.fixture
def every_state(monkeypatch: pytest.MonkeyPatch) -> Callable[[Scene], MujocoCollisionChecker]:
    """The slow twin: MuJoCo looks at every state."""

    class EveryState(MujocoCollisionChecker):
        def deepest_penetration(self, *args: Any, **kwargs: Any) -> PenetrationReport:
            with monkeypatch.context() as patch:
                patch.setattr(mujoco_check, "unproved_states", lambda _, states: np.ones(len(states), np.bool_))
                return super().deepest_penetration(*args, **kwargs)

    return EveryState


def random_paths(scene: Scene, count: int) -> list[WholeBodyPath]:
    """Motions of base, torso and arm among the objects, with and without one in the gripper."""
    rng, robot = np.random.default_rng(0), CollisionWorld.from_scene(scene).robot
    paths = []
    for k in range(count):
        q = np.clip(HOME + rng.normal(size=(3, len(HOME))) * (0.3 if k % 3 else 0.1), robot.lower, robot.upper)
        base = BASE + rng.normal(size=(3, 3)) * (0.1, 0.1, 0.2) * (k % 2) + (0.3 * (k % 4 == 1), 0.0, 0.0)
        X = np.hstack([base, q])
        paths.append(WholeBodyPath(X, 0.05, HeldObject("object_02", np.eye(4)) if k % 3 else None, ignore=k % 4))
    return paths


def test_states_are_left_out_only_where_nothing_is_touched(
    every_state: Callable[[Scene], MujocoCollisionChecker],
) -> None:
    scene = mixed_scene(20, 4)
    checker, twin, left_out = MujocoCollisionChecker(scene), every_state(scene), 0
    for path in random_paths(scene, 24):
        found, expected = checker.deepest_penetration(path), twin.deepest_penetration(path)
        assert found.penetration == pytest.approx(expected.penetration, abs=1e-9)
        left_out += found.penetration < 0.002
        assert checker.accepts(path) == (expected.penetration <= TOLERANCE)
    assert 5 < left_out < 20


def test_what_is_proved_to_be_free_touches_nothing_in_between_either() -> None:
    """States far apart: ten times as many between them, and the fingers half-way, are free where it is proved."""
    world, proved = CollisionWorld.from_scene(mixed_scene(20, 4), 0.0), 0
    for path in random_paths(world.scene, 24):
        states = np.column_stack([path.configurations, (0.0, 0.02, 0.03)])
        states = interpolate(np.linspace(0, 2, 41), np.arange(3), states)
        free = ~unproved_states(world.query(0.0, path.held, path.ignore), states)
        between = interpolate(np.linspace(0, 40, 401), np.arange(41), states)
        for x, is_free in zip(between, free[np.round(np.linspace(0, 40, 401)).astype(int)], strict=True):
            if is_free:
                assert not world.hits(x[:3], x[3:-1], FETCH.opening(x[-1]), path.held, path.ignore)
                proved += 1
    assert 1000 < proved < 9000


def test_shapes_that_always_touch_count_for_neither_check(tmp_path: Path) -> None:
    spec = mujoco.MjSpec.from_file(str(FETCH.mjcf_path))
    for name in ("wrist_roll_link", "forearm_roll_link"):  # two joints apart, so wide that they touch in every posture
        spec.body(name).add_geom(
            name=f"cover_{name}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.2, 0, 0], contype=2, conaffinity=0, mass=0
        )
    spec.compile()
    file = tmp_path / "wide.xml"
    file.write_text(spec.to_xml())
    scene = replace(table_scene(), robot=replace(FETCH, name="wide", mjcf=str(file)))
    world, checker = CollisionWorld.from_scene(scene), MujocoCollisionChecker(scene)
    rng, base = np.random.default_rng(0), np.array([-3.0, 0.0, 0.0])
    lower, upper = np.maximum(world.robot.lower, -3), np.minimum(world.robot.upper, 3)
    free = [q for q in rng.uniform(lower, upper, (400, 8)) if not world.hits(base, q, 0.1)]
    assert len(free) > 5
    for q in free[:20]:
        report = checker.deepest_penetration(arm_path(base, q[None], 0.1))
        assert report.penetration <= TOLERANCE, report
