"""A robot that an object touches at the start moves away from it first, and comes no nearer to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from assets.robots import FETCH
from planners import Solution, solve
from planners.collision.world import CollisionWorld
from planners.motion.base import plan_base
from planners.motion.mujoco_check import MujocoCollisionChecker
from planners.motion.path import WholeBodyPath
from planners.scene import Body, Scene
from tests.planners.scenes import UPRIGHT, cylinder, table_scene

RADIUS = 0.03


def _touched(angle: float, gap: float) -> Scene:
    """The robot with a can on the floor beside its base, in that direction [rad] and at about that distance [m]."""
    scene = table_scene(cylinder("target", -0.2, 0.0))
    base = scene.state.base
    body = Body("can", "cylinder", np.array([RADIUS, RADIUS, 0.08]), np.array([0.0, 0.0, 0.08]), UPRIGHT)
    low, high = 0.1, 1.0
    while high - low > 1e-5:  # the distance at which the base begins to come nearer than `gap`
        middle = 0.5 * (low + high)
        there = base[:2] + middle * np.array([np.cos(angle), np.sin(angle)])
        world = CollisionWorld.from_scene(replace(scene, objects=(*scene.objects, body.at([*there, 0.08]))), gap)
        low, high = (middle, high) if world.hits(base, FETCH.home, 0.1) else (low, middle)
    assert world.scene.objects
    return world.scene


@pytest.mark.parametrize("angle", [0.0, 0.8, 2.5, -1.6])
@pytest.mark.parametrize("gap", [0.0, 0.001])
def test_the_robot_leaves_what_touches_it(angle: float, gap: float) -> None:
    scene = _touched(angle, gap)
    world = CollisionWorld.from_scene(scene)
    assert world.hits(scene.state.base, scene.state.q, 0.1)
    goal = scene.state.base - 0.4 * np.array([np.cos(angle), np.sin(angle), 0.5])
    path = plan_base(world, scene.state.base, goal, scene.state.q)
    assert isinstance(path, WholeBodyPath), path
    assert not world.path_hits(path.configurations[1:], path.opening)
    assert MujocoCollisionChecker(scene).deepest_penetration(path).penetration < 0.001


def test_a_target_is_taken_although_a_can_touches_the_base() -> None:
    found = solve(_touched(0.3, 0.0005), "target", rng=np.random.default_rng(0))
    assert isinstance(found, Solution), found
