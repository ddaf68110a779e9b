"""Base paths: no part of the robot hits anything; where there is no path, the reason is given."""

from __future__ import annotations

import math

import numpy as np
import pytest

from assets.robots import FETCH
from planners.collision.world import STEP, CollisionWorld
from planners.motion.base import plan_base
from planners.motion.path import NoPath, WholeBodyPath
from planners.scene import HeldObject
from tests.planners.motion_scenes import mixed_scene
from tests.planners.scenes import cylinder, table_scene

HOME = np.array(FETCH.home)
HANGING = HeldObject("object_00", np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.02], [0, 0, 0, 1.0]]))


@pytest.mark.parametrize("held", [None, HANGING])
def test_drives_are_free_when_checked_finer_and_end_where_asked(held: HeldObject | None) -> None:
    world = CollisionWorld.from_scene(mixed_scene(20, 0))
    rng = np.random.default_rng(0)
    planned = 0
    for _ in range(30):
        start, goal = (
            np.array([rng.uniform(-1.4, -0.7), rng.uniform(-0.5, 0.5), rng.uniform(-0.6, 0.6)]) for _ in "ab"
        )
        if world.hits(start, HOME, FETCH.max_opening, held) or world.hits(goal, HOME, FETCH.max_opening, held):
            continue
        path = plan_base(world, start, goal, HOME, held=held)
        assert isinstance(path, WholeBodyPath)
        planned += 1
        assert np.allclose(path.base, start)
        assert np.allclose(path.end_base, goal)
        tight = world.with_padding(0.0)
        for opening in (0.0, FETCH.max_opening):
            assert tight.path_hits(path.configurations, opening, held, step=STEP / 4) == 0
    assert planned >= 15


def test_the_shorter_turn_is_taken_and_yaw_is_continuous() -> None:
    world = CollisionWorld.from_scene(table_scene())
    path = plan_base(world, [-1.5, 0.0, 3.0], [-1.5, 0.2, -3.0], HOME)
    assert isinstance(path, WholeBodyPath)
    turned = np.diff(path.configurations[:, 2]).sum()
    assert turned == pytest.approx(2 * math.pi - 6.0)


def test_a_detour_is_found_where_the_straight_line_is_blocked() -> None:
    """An object as high as the gripper stands between start and goal."""
    tower = cylinder("object_00", -0.45, 0.0, radius=0.1, height=0.6)
    world = CollisionWorld.from_scene(table_scene(tower))
    start, goal = np.array([-1.05, 0.45, 0.0]), np.array([-1.05, -0.45, 0.0])
    straight = np.hstack([np.stack([start, goal]), np.tile(HOME, (2, 1))])
    assert world.path_hits(straight, FETCH.max_opening)
    path = plan_base(world, start, goal, HOME)
    assert isinstance(path, WholeBodyPath)
    assert world.path_hits(path.configurations, FETCH.max_opening) == 0


@pytest.mark.parametrize(
    ("start", "goal", "name"), [((0.0, 0, 0), (-1, 0, 0), "start"), ((-1, 0, 0), (0.2, 0, 0), "goal")]
)
def test_standing_inside_an_obstacle_is_named(start: tuple[float, ...], goal: tuple[float, ...], name: str) -> None:
    found = plan_base(CollisionWorld.from_scene(table_scene()), start, goal, HOME)
    assert isinstance(found, NoPath)
    assert name in found.reason
    assert "static obstacle" in found.reason
