"""MuJoCo's collision check: what it finds, what it ignores on purpose, and that it can be used again."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from assets.robots import FETCH
from planners.collision.hit_kernels import place_along
from planners.collision.scene_arrays import robot_arrays
from planners.collision.world import CollisionWorld
from planners.motion.arm import tcp_pose
from planners.motion.mujoco_check import TOLERANCE, MujocoCollisionChecker
from planners.motion.path import WholeBodyPath
from planners.motion.pick_and_place import PickPlaceMotion, plan_pick
from planners.motion.timing import pick_trajectory
from planners.motion.trajectory import Phase, Trajectory
from planners.motion.travel import pair_kind
from planners.scene import HeldObject, RobotState, Scene, SceneError
from tests.planners.motion_scenes import arm_path, grasp_configurations, mixed_scene
from tests.planners.scenes import cylinder, table_scene

CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
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
    loaded = arm_path(empty.base, empty.configurations[:, 3:], 0.05, HeldObject("object_02", np.eye(4)))
    first = checker.deepest_penetration(empty)
    checker.deepest_penetration(loaded)
    assert checker.deepest_penetration(empty).penetration == first.penetration


def test_moving_to_another_scene_equals_building_anew() -> None:
    scene = mixed_scene(12, 2)
    moved = scene.with_body(scene.body("object_00").at([-0.3, 0.0, 1.05]))
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


class EveryState(MujocoCollisionChecker):
    """The slow twin: everything moves far between two states, so that none is left out."""

    def _travelled(self, states: np.ndarray, held: HeldObject | None) -> np.ndarray:
        return np.arange(len(states))[:, None] * np.full(super()._travelled(states[:1], held).shape, 1e6)


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


def test_states_are_left_out_only_where_nothing_is_touched() -> None:
    scene = mixed_scene(20, 4)
    checker, twin, left_out = MujocoCollisionChecker(scene), EveryState(scene), 0
    for path in random_paths(scene, 24):
        found, expected = checker.deepest_penetration(path), twin.deepest_penetration(path)
        assert found.penetration == pytest.approx(expected.penetration, abs=1e-9)
        left_out += found.penetration < 0.002
        assert checker.accepts(path) == (expected.penetration <= TOLERANCE)
    assert 5 < left_out < 20


def test_distances_are_reported_as_far_as_the_margins() -> None:
    """What is not reported is at least as far away as `_margins` says, whatever MuJoCo makes of two margins."""
    scene = mixed_scene(20, 4)
    checker = MujocoCollisionChecker(scene)
    model, data = checker._model, checker._data
    apart = 0
    for path in random_paths(scene, 12):
        for x in path.configurations:
            checker._place(np.append(x, 0.03), None)
            reported = {frozenset(pair) for pair in data.contact.geom.tolist()}
            for robot_geom in checker._gripper:
                for geom in checker._names:
                    distance = mujoco.mj_geomDistance(model, data, robot_geom, geom, 0.2, None)
                    if distance > 0.001 and frozenset((robot_geom, geom)) not in reported:
                        assert distance > checker._margins[0] - 1e-6
                        apart += distance < 0.1
    assert apart > 10


def test_no_point_moves_farther_than_the_bounds_say() -> None:
    scene = mixed_scene(10, 0)
    checker, robot = MujocoCollisionChecker(scene), robot_arrays(FETCH)
    held, links = HeldObject("object_02", np.eye(4)), len(FETCH.chain) + 1
    world = CollisionWorld.from_scene(scene)
    for path in random_paths(scene, 8):
        at = np.linspace(0, 2, 41)
        X = np.column_stack([np.interp(at, np.arange(3), column) for column in path.configurations.T])
        bounds = checker._travelled(np.column_stack([X, np.full(len(X), 0.02)]), held)
        positions, rotations = place_along(world.query(0.05, held), X)
        link, half = np.append(robot.link, links - 2) + 1, np.vstack([robot.half, scene.body("object_02").half_extents])
        corners = positions[:, :, None] + np.einsum("nsij,skj->nski", rotations, half[:, None] * CORNERS)
        for first, last in ((0, 40), (3, 9), (17, 24)):
            moved = np.linalg.norm(corners[last] - corners[first], axis=2).max(axis=1)
            assert (moved <= (bounds[last] - bounds[first])[link] + 1e-9).all()
            for one, other in itertools.product((0, 4, 9, len(link) - 1), (14, 8, 2)):
                seen = [(corners[k, one] - positions[k, other]) @ rotations[k, other] for k in (first, last)]
                kind = pair_kind(int(link[one]), int(link[other]), links)
                assert (
                    np.linalg.norm(seen[1] - seen[0], axis=1).max() <= bounds[last, kind] - bounds[first, kind] + 1e-9
                )


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
