"""The compiled check against its slow NumPy twin, against MuJoCo, and against itself."""

from __future__ import annotations

import itertools
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from assets.robots import FETCH
from planners.collision.hit_kernels import edge_samples, place_along
from planners.collision.scene_arrays import obstacle_arrays
from planners.collision.world import PADDING, STEP, SUPPORT_SLACK, CollisionWorld, validate
from planners.motion.arm import tcp_pose
from planners.motion.mujoco_check import MujocoCollisionChecker
from planners.motion.path import CLEARANCE
from planners.motion.trajectory import Phase, Trajectory
from planners.scene import (
    SELF_BIT,
    STATIC_BIT,
    HeldObject,
    RobotState,
    Scene,
    SceneError,
    StaticObstacle,
    UnknownObject,
)
from tests.planners.collision.slow_gjk import project, slow_hits
from tests.planners.motion_scenes import arm_path, grasp_configurations, mixed_scene
from tests.planners.scenes import cylinder, table_scene

BASE = np.array([-0.72, 0.05, 0.1])
OPENING = 0.08
HELD = HeldObject("object_02", np.eye(4))
SHAPES = ("box", "cylinder", "capsule", "sphere", "ellipsoid", "hull")


def random_configurations(world: CollisionWorld, count: int, seed: int) -> NDArray[np.float64]:
    """Half of them anywhere, half near configurations in the clutter."""
    rng = np.random.default_rng(seed)
    anywhere = rng.uniform(world.robot.lower, world.robot.upper, (count // 2, 8))
    low = np.array([0.2, 0.0, 0.1, -1.5, 1.3, 2.6, 1.0, -1.8])
    return np.vstack([anywhere, rng.normal(low, 0.45, (count - count // 2, 8))])


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
@pytest.mark.parametrize("held", [None, HELD])
def test_free_and_hit_mean_the_same_to_mujoco(seed: int, held: HeldObject | None) -> None:
    """Without padding both agree on thousands of configurations, but for touches by less than a micrometre."""
    world = CollisionWorld.from_scene(mixed_scene(30, seed, board=seed == 0), padding=0.0)
    checker = MujocoCollisionChecker(world.scene)
    Q = random_configurations(world, 700, seed)
    hits = world.hits_many(BASE, Q, OPENING, held)
    slack = 1e-6 if held is None else 0.001
    for q, mask in zip(Q, hits, strict=True):
        depth = checker.deepest_penetration(arm_path(BASE, q[None], OPENING, held)).penetration
        assert (depth > 0.0) == bool(mask) or depth < slack


@pytest.mark.parametrize("seed", range(2))
def test_larger_paddings_hit_more(seed: int) -> None:
    """What is hit with one padding is hit with every larger one."""
    world = CollisionWorld.from_scene(mixed_scene(30, seed))
    Q = random_configurations(world, 2000, seed)
    masks = [world.with_padding(padding).hits_many(BASE, Q, OPENING) for padding in (0.0, 0.001, 0.002, 0.01)]
    for tight, wide in itertools.pairwise(masks):
        assert not (tight & ~wide).any()


def test_ignored_bits_never_show_and_others_stay() -> None:
    world = CollisionWorld.from_scene(mixed_scene(30, 1))
    Q = random_configurations(world, 500, 1)
    ignore = world.scene.mask(world.scene.names[::2]) | 1 << STATIC_BIT
    everything = world.hits_many(BASE, Q, OPENING)
    assert np.array_equal(world.hits_many(BASE, Q, OPENING, ignore=ignore), everything & ~np.uint64(ignore))


def test_the_held_object_is_no_obstacle_and_may_stand_on_the_table() -> None:
    world = CollisionWorld.from_scene(mixed_scene(12, 3))
    rng = np.random.default_rng(0)
    checked = 0
    for body in world.scene.objects:
        if not body.is_upright:
            continue
        for base, q in grasp_configurations(world, body.name, rng):
            T_world_tcp = tcp_pose(FETCH, RobotState(base, q, 0.0))
            held = HeldObject(body.name, np.linalg.inv(T_world_tcp) @ body.pose)
            grip = 2 * body.half_width
            assert world.hits(base, q, grip, held) == 0
            sunk = held.T_tcp_object.copy()
            sunk[2, 3] -= 0.003
            assert world.hits(base, q, grip, HeldObject(body.name, sunk)) >> STATIC_BIT & 1
            checked += 1
    assert checked > 3


def test_fingers_move_with_the_opening() -> None:
    world = CollisionWorld.from_scene(mixed_scene(1, 0))
    x = np.append(BASE, FETCH.home)[None]
    for opening in (0.0, 0.03, 0.09):
        position, _ = place_along(world.query(opening), x)
        apart = np.linalg.norm(position[0, 0] - position[0, 1])
        inner = apart - FETCH.finger_thickness
        assert inner == pytest.approx(FETCH.finger_gap_closed + 2 * FETCH.finger_position(opening), abs=1e-6)


def test_fingers_that_press_on_an_object_stay_at_its_width() -> None:
    """Whatever they are commanded to: what they hit beside the object is hit, for this check and for MuJoCo's."""
    held_body, beside = cylinder("object_00", 0.0, 0.0, 0.035), cylinder("object_01", 0.0, 0.3, 0.01)
    T_world_tcp = tcp_pose(FETCH, RobotState(BASE, np.array(FETCH.home), 0.0))
    held = HeldObject("object_00", np.eye(4))
    T_beside = T_world_tcp.copy()
    T_beside[:3, 3] += T_world_tcp[:3, 1] * (held_body.radius + FETCH.finger_thickness + beside.radius - 0.004)
    world = CollisionWorld.from_scene(table_scene(held_body, beside.at_pose(T_beside)), padding=0.0)
    checker, states = MujocoCollisionChecker(world.scene), np.array([*BASE, *FETCH.home])
    still = Trajectory(
        0.05 * np.arange(2),
        states[None, :3].repeat(2, 0),
        states[None, 3:].repeat(2, 0),
        np.zeros(2),
        (Phase("lift", 0.0, held.name, held),),
    )
    assert world.hits(BASE, FETCH.home, held_body.radius * 2, held) == 1 << 1
    assert world.hits(BASE, FETCH.home, FETCH.opening(0.0), held) == 1 << 1
    assert "object_01" in checker.deepest_penetration(still).pair


def corners(world: CollisionWorld, x: NDArray[np.float64], held: HeldObject | None) -> NDArray[np.float64]:
    """World points (n, 3): the corners of the box around every core."""
    query, count = world.query(OPENING, held), len(world.robot.core) + (held is not None)
    position, rotation = (placed[0, :count] for placed in place_along(query, x[None]))
    signs = np.array([(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
    turned = np.einsum("nij,nkj->nki", rotation, query.scratch.solids.half[:count, None, :] * signs)
    return np.asarray((position[:, None, :] + turned).reshape(-1, 3))


@pytest.mark.parametrize("held", [None, HELD])
def test_no_point_moves_further_than_a_step_between_samples(held: HeldObject | None) -> None:
    world = CollisionWorld.from_scene(mixed_scene(5, 0))
    reach = world.query(OPENING, held).attached.reach
    rng = np.random.default_rng(0)
    step = 0.02
    for _ in range(50):
        ends = [np.append(rng.uniform(-1, 1, 3), rng.uniform(world.robot.lower, world.robot.upper)) for _ in range(2)]
        parts = edge_samples(reach, *ends, step)
        k = rng.integers(parts)
        before, after = (corners(world, ends[0] + (ends[1] - ends[0]) * i / parts, held) for i in (k, k + 1))
        assert np.linalg.norm(after - before, axis=1).max() <= step


def test_moving_a_body_equals_compiling_the_moved_scene() -> None:
    """Every array is the same, bit for bit, wherever the body moves and however it then lies."""
    world = CollisionWorld.from_scene(mixed_scene(12, 3, board=True), padding=0.004)
    rng = np.random.default_rng(0)
    for name in world.scene.names:
        quaternion = rng.normal(size=4)
        body = world.scene.body(name).at(rng.uniform(-1.0, 1.0, 3), quaternion / np.linalg.norm(quaternion))
        moved, compiled = world.with_body(body), CollisionWorld.from_scene(world.scene.with_body(body), 0.004)
        assert moved.scene.objects == compiled.scene.objects
        assert moved.padding == compiled.padding
        assert moved.obstacles.static is world.obstacles.static
        pairs = [*zip(moved.obstacles[:-2], compiled.obstacles[:-2], strict=True)]
        for one, other in [*zip(*pairs[0], strict=True), *pairs[1:]]:
            assert np.array_equal(one, other)
            assert one.dtype == other.dtype
            assert one.flags.c_contiguous
    with pytest.raises(UnknownObject, match="object_00"):
        world.with_body(replace(world.scene.body("object_00"), name="cup"))


def test_a_path_hits_what_its_configurations_hit() -> None:
    world = CollisionWorld.from_scene(mixed_scene(25, 6))
    Q = random_configurations(world, 40, 7)[20:]
    X = np.hstack([np.tile(BASE, (len(Q), 1)), Q])
    for a, b in itertools.pairwise(X):
        dense = a[3:] + (b - a)[3:] * np.linspace(0, 1, 120)[:, None]
        union = int(np.bitwise_or.reduce(world.hits_many(BASE, dense, OPENING)))
        on_path = world.path_hits(np.stack([a, b]), OPENING, step=0.002)
        touched = world.with_padding(0.0).path_hits(np.stack([a, b]), OPENING)
        assert touched & ~on_path == 0
        assert union & ~world.with_padding(0.004).path_hits(np.stack([a, b]), OPENING, step=0.002) == 0


def checked_one_by_one(world: CollisionWorld, X: NDArray[np.float64], held: HeldObject | None, ignore: int) -> int:
    """The slow twin of `path_hits`: every configuration that it may look at."""
    reach, hits = world.query(OPENING, held).attached.reach, world.hits(X[0, :3], X[0, 3:], OPENING, held, ignore)
    for a, b in itertools.pairwise(X):
        parts = edge_samples(reach, a, b, STEP)
        for x in [*(a + (b - a) * i / parts for i in range(1, parts)), b]:
            hits |= world.hits(x[:3], x[3:], OPENING, held, ignore)
    return hits


@pytest.mark.parametrize("seed", range(3))
def test_checks_are_left_out_along_a_path_only_where_nothing_is_near(seed: int) -> None:
    """Robot, objects, static obstacles and self-collision, with and without an object in hand."""
    scene, rng, hits = mixed_scene(20, seed), np.random.default_rng(seed), []
    for k in range(24):
        world = CollisionWorld.from_scene(scene, padding=(0.002, 0.01, 0.0)[k % 3])
        q = np.array(FETCH.home) + rng.normal(size=(3, 8)) * (0.3, 0.1, 0.03)[k % 3]
        base = np.array((-1.1, 0.0, 0.0)) + rng.normal(size=(3, 3)) * (0.1, 0.1, 0.2) * (k % 2)
        base[:, 0] += 0.3 * (k % 4 == 1)
        X = np.hstack([base, np.clip(q, world.robot.lower, world.robot.upper)])
        held, ignore = HeldObject("object_02", np.eye(4)) if k % 3 else None, (0, 1, 1 << SELF_BIT, 5)[k % 4]
        hits.append(checked_one_by_one(world, X, held, ignore))
        assert world.path_hits(X, OPENING, held, ignore) == hits[-1]
        assert bool(world.path_hits(X, OPENING, held, ignore, first_only=True)) == bool(hits[-1])
        edges = [bool(checked_one_by_one(world, X[row : row + 2], None, ignore)) for row in range(2)]
        assert world.edges_that_hit(X, OPENING, ignore).tolist() == edges
    assert 3 < np.count_nonzero(hits) < 21


def random_obstacle(name: str, shape: str, rng: np.random.Generator) -> StaticObstacle:
    """Somewhere around the arm, turned anyhow."""
    matrix, quaternion = np.empty(9), rng.normal(size=4)
    mujoco.mju_quat2Mat(matrix, quaternion / np.linalg.norm(quaternion))
    rotation, position = matrix.reshape(3, 3), np.append(rng.uniform((-0.6, -0.5), (0.2, 0.5)), rng.uniform(0.8, 1.4))
    half = rng.uniform(0.03, 0.12, 3)
    if shape == "hull":
        return StaticObstacle.hull(name, rng.uniform(-0.12, 0.12, (14, 3)), position, rotation)
    if shape in ("cylinder", "capsule", "sphere"):
        half[1] = half[0]
        half[2] = half[0] if shape == "sphere" else half[0] + half[2]
    return StaticObstacle(name, position, half, shape, rotation)  # type: ignore[arg-type] # one of SHAPES


def shaped_scene(seed: int, shapes: tuple[str, ...] = SHAPES, objects: int = 6) -> Scene:
    """A cluttered table with one obstacle of each shape."""
    rng, scene = np.random.default_rng(seed), mixed_scene(objects, seed)
    extra = tuple(random_obstacle(f"{shape}_{i}", shape, rng) for i, shape in enumerate(shapes))
    return replace(scene, static_obstacles=(*scene.static_obstacles, *extra))


@pytest.mark.parametrize(("held", "yields"), [(None, 0.0), (HELD, 0.0), (HELD, 0.004)])
def test_the_compiled_check_equals_its_slow_twin(held: HeldObject | None, yields: float) -> None:
    """Of standing and lying objects and static obstacles of every shape."""
    world = replace(CollisionWorld.from_scene(shaped_scene(1, objects=14)), yields=yields)
    Q = random_configurations(world, 60, 0)
    found = world.hits_many(BASE, Q, OPENING, held)
    assert 0 < np.count_nonzero(found >> np.uint64(STATIC_BIT)) < len(Q)
    assert (found & np.uint64((1 << 14) - 1)).any()
    for q, hits in zip(Q, found, strict=True):
        assert int(hits) == slow_hits(world, BASE, q, OPENING, held), world.names_of(int(hits))


@pytest.mark.parametrize("shape", SHAPES)
def test_static_obstacles_are_free_and_hit_as_for_mujoco(shape: str) -> None:
    world = CollisionWorld.from_scene(shaped_scene(2, (shape,) * 4, objects=0), padding=0.0)
    alone = replace(world.scene, static_obstacles=world.scene.static_obstacles[-4:])
    world = CollisionWorld.from_scene(alone, padding=0.0)
    checker = MujocoCollisionChecker(alone)
    Q = random_configurations(world, 500, 2)
    hits = world.hits_many(BASE, Q, OPENING)
    touching = 0
    for q, mask in zip(Q, hits, strict=True):
        report = checker.deepest_penetration(arm_path(BASE, q[None], OPENING))
        assert (report.penetration > 0.0) == bool(mask) or report.penetration < 1e-5
        touching += any(name.startswith(shape) for name in report.pair)
    assert touching > 20


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("seed", range(4))
def test_extents_and_outlines_contain_the_solid_and_touch_it(shape: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    obstacle = random_obstacle("it", shape, rng)
    solids = obstacle_arrays(Scene(*_empty(), (obstacle,))).static
    far = obstacle.position + 100 * rng.normal(size=(300, 3))
    points = np.array([project(solids, 0, point) for point in far])
    outwards = (far - points) / np.linalg.norm(far - points, axis=1, keepdims=True)
    points += solids.radius[0] * outwards
    assert np.all(points >= obstacle.lower - 1e-9)
    assert np.all(points <= obstacle.upper + 1e-9)
    assert np.all(obstacle.is_under(points[:, :2] * (1 - 1e-9) + obstacle.position[:2] * 1e-9))
    for axis in range(3):
        for sign in (-1, 1):
            end = obstacle.position + 1e6 * sign * np.eye(3)[axis]
            extreme = project(solids, 0, end)[axis] + sign * solids.radius[0]
            assert extreme == pytest.approx((obstacle.lower, obstacle.upper)[sign > 0][axis], abs=1e-5)


def _empty() -> tuple:
    scene = table_scene()
    return scene.robot, scene.state, ()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shape": "cone"}, "known shapes"),
        ({"half_extents": [0.1, 0.0, 0.1]}, "positive"),
        ({"half_extents": [0.1, 0.2, 0.3], "shape": "sphere"}, "fit no sphere"),
        ({"half_extents": [0.1, 0.1, 0.05], "shape": "capsule"}, "fit no capsule"),
        ({"rotation": np.full((3, 3), 0.5)}, "rotation matrix"),
        ({"shape": "hull"}, "fit no hull"),
        ({"position": [0, np.inf, 0]}, "finite"),
    ],
)
def test_impossible_obstacles_are_refused(change: dict, message: str) -> None:
    sizes = {"name": "it", "position": [0, 0, 0], "half_extents": [0.1, 0.1, 0.1]}
    with pytest.raises(SceneError, match=message):
        StaticObstacle(**(sizes | change))
    with pytest.raises(SceneError, match="enclose no volume"):
        StaticObstacle.hull("flat", [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])


def test_a_robot_inside_an_obstacle_is_told_which_one() -> None:
    scene = table_scene(cylinder("object_00", 0.0, 0.0))
    pole = StaticObstacle("pole", np.array([-1.1, 0.0, 1.0]), np.array([0.05, 0.05, 1.0]), "cylinder")
    validate(CollisionWorld.from_scene(scene))
    with pytest.raises(SceneError, match=r"inside pole with its base.* at base pose"):
        validate(CollisionWorld.from_scene(replace(scene, static_obstacles=(*scene.static_obstacles, pole))))


def test_obstacles_may_be_called_as_parts_of_the_robot_are() -> None:
    scene = table_scene(cylinder("palm", 0.0, 0.0))
    twins = [
        StaticObstacle(name, np.array([0.0, 3.0 + i, 0.2]), np.full(3, 0.1), "sphere")
        for i, name in enumerate(("floor", "palm", "base"))
    ]
    checker = MujocoCollisionChecker(replace(scene, static_obstacles=(*scene.static_obstacles, *twins)))
    path = arm_path(np.array([0.0, 3.0, 0.0]), np.array(scene.state.q)[None], OPENING)
    assert set(checker.deepest_penetration(path).pair) & {"floor", "palm", "base"}


@pytest.mark.parametrize("padding", [PADDING, CLEARANCE])
def test_what_is_held_keeps_below_it_what_is_asked_for_but_for_what_a_lift_takes(padding: float) -> None:
    """With a clearance of a centimetre it passed one millimetre above trays, and the arm lags by more."""
    base, body = np.array([-1.1, 0.0, 0.0]), cylinder("held", 0.0, 0.0)
    T_world_tcp = tcp_pose(FETCH, RobotState(base, np.array(FETCH.home), 0.0))
    body = body.at(T_world_tcp[:3, 3])
    held, scene = HeldObject.grasped(body, T_world_tcp), table_scene(body)
    for gap in (0.0, 0.004, 0.007, 0.008):
        centre = [*body.position[:2], body.bottom - gap - 0.01]
        slab = StaticObstacle("slab", np.array(centre), np.array([0.1, 0.1, 0.01]))
        world = CollisionWorld.from_scene(replace(scene, static_obstacles=(slab,)), padding)
        hits = world.hits(base, FETCH.home, 0.0, held) & 1 << STATIC_BIT
        assert bool(hits) == (gap < padding - PADDING - SUPPORT_SLACK)
