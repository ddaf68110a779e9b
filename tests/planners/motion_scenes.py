"""Cluttered scenes of standing and lying cylinders and boxes, and grasp configurations in them, for the tests of
motions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from assets.robots import FETCH
from irm.chain import ArmChain
from planners.collision.world import CollisionWorld
from planners.motion.path import WholeBodyPath, on_base
from planners.scene import Body, HeldObject, Scene, StaticObstacle
from tests.irm.arms import inverse
from tests.planners.scenes import HEIGHT, random_scene

CHAIN = ArmChain.from_robot(FETCH)
BOARD = StaticObstacle("shelf_board", np.array([0.0, 0.0, HEIGHT + 0.41]), np.array([0.35, 0.52, 0.01]))


def mixed_scene(count: int, seed: int, board: bool = False) -> Scene:
    """Cylinders and boxes in turn; every seventh lies, a little above the table so that it touches nothing there."""
    scene = random_scene(count, seed)
    rng = np.random.default_rng(seed)
    objects = tuple(_varied(body, i, rng) for i, body in enumerate(scene.objects))
    obstacles = (*scene.static_obstacles, BOARD) if board else scene.static_obstacles
    return replace(scene, objects=objects, static_obstacles=obstacles)


def arm_path(
    base: NDArray[np.float64],
    waypoints: NDArray[np.float64],
    opening: float,
    held: HeldObject | None = None,
    ignore: int = 0,
) -> WholeBodyPath:
    """A motion of the arm through waypoints (n, 8) on a standing base."""
    return WholeBodyPath(on_base(base, waypoints), opening, held, ignore)


def _varied(body: Body, index: int, rng: np.random.Generator) -> Body:
    if index % 2:
        half = np.array([*(body.half_extents[:2] * rng.uniform(0.6, 0.8, 2)), body.half_extents[2]])
        yaw = rng.uniform(-np.pi, np.pi)
        body = replace(body, shape="box", half_extents=half, quaternion=[np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
    if index % 7 == 3:
        quaternion = rng.normal(size=4)
        lying = body.at(body.position, quaternion / np.linalg.norm(quaternion))
        body = lying.at(lying.position + [0.0, 0.0, HEIGHT + 0.001 - lying.bottom])
    return body


def grasp_configurations(
    world: CollisionWorld, name: str, rng: np.random.Generator, count: int = 1
) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Up to `count` base poses (3,) with a free configuration (8,) around an object, the gripper level."""
    body, found = world.scene.body(name), []
    for _ in range(60):
        base = np.array([rng.uniform(-1.05, -0.65), np.clip(body.position[1] + rng.uniform(-0.4, 0.4), -0.6, 0.6), 0.0])
        yaw = body.yaw if body.shape == "box" else rng.uniform(-1.2, 1.2)
        yaw = (yaw + np.pi / 4) % (np.pi / 2) - np.pi / 4
        T = np.eye(4)
        T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
        T[:3, 3] = [*(body.position[:2] - base[:2]), body.bottom + FETCH.grasp_height]
        configurations = inverse(CHAIN, T, np.linspace(0.05, 0.38, 6), np.linspace(-np.pi, np.pi, 24, endpoint=False))
        if not len(configurations):
            continue
        free = configurations[world.hits_many(base, configurations, 2 * (body.half_width + FETCH.finger_gap)) == 0]
        if len(free):
            found.append((base, free[rng.integers(len(free))]))
        if len(found) == count:
            break
    return found
