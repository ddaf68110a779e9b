"""Static obstacles of every shape: the compiled check against its slow twin and against MuJoCo."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from planners.collision.scene_arrays import obstacle_arrays
from planners.collision.world import CollisionWorld, validate
from planners.motion.mujoco_check import MujocoCollisionChecker
from planners.scene import STATIC_BIT, HeldObject, Scene, SceneError, StaticObstacle
from tests.planners.collision.slow_gjk import project, slow_hits
from tests.planners.motion_scenes import arm_path, mixed_scene
from tests.planners.scenes import cylinder, table_scene

BASE = np.array([-0.72, 0.05, 0.1])
OPENING = 0.08
SHAPES = ("box", "cylinder", "capsule", "sphere", "ellipsoid", "hull")
HELD = HeldObject("object_02", np.eye(4))


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


def configurations(world: CollisionWorld, count: int, seed: int) -> NDArray[np.float64]:
    return np.random.default_rng(seed).uniform(world.robot.lower, world.robot.upper, (count, 8))


@pytest.mark.parametrize("held", [None, HELD])
def test_the_compiled_check_equals_its_slow_twin(held: HeldObject | None) -> None:
    world = CollisionWorld.from_scene(shaped_scene(1))
    Q = configurations(world, 40, 1)
    found = world.hits_many(BASE, Q, OPENING, held)
    hit = np.count_nonzero(found >> np.uint64(STATIC_BIT))
    assert 0 < hit < len(Q)
    for q, hits in zip(Q, found, strict=True):
        assert int(hits) == slow_hits(world, BASE, q, OPENING, held), world.names_of(int(hits))


@pytest.mark.parametrize("shape", SHAPES)
def test_free_and_hit_mean_the_same_to_mujoco(shape: str) -> None:
    world = CollisionWorld.from_scene(shaped_scene(2, (shape,) * 4, objects=0), padding=0.0)
    alone = replace(world.scene, static_obstacles=world.scene.static_obstacles[-4:])
    world = CollisionWorld.from_scene(alone, padding=0.0)
    checker = MujocoCollisionChecker(alone)
    Q = configurations(world, 500, 2)
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
    with pytest.raises(SceneError, match="inside pole at base pose"):
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
