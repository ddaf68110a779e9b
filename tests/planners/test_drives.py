"""Whole plans behind walls: around them, through a door, or refused with their name."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from assets.robots import FETCH
from planners import Infeasible, Solution, solve
from planners.cause import Cause
from planners.scene import RobotState, Scene, StaticObstacle
from tests.planners.scenes import ROOM, random_scene, wall

DOOR = wall("door", (-1.8, -0.5), (-1.8, 0.5))


def behind(walls: Iterable[StaticObstacle], x: float = -3.4) -> Scene:
    """Eight objects on a table, and the robot behind walls."""
    scene, state = random_scene(8, 1), RobotState(np.array([x, 0.0, 0.0]), np.array(FETCH.home), 0.05)
    return replace(scene, state=state, static_obstacles=(*scene.static_obstacles, *walls))


@pytest.mark.parametrize("walls", [ROOM, (wall("long", (-1.9, -2.2), (-1.9, 2.2)),)], ids=["door", "long wall"])
@pytest.mark.parametrize("grasps", ["all", "side"])
def test_the_robot_comes_to_the_table_around_a_wall_and_through_a_door(
    walls: tuple[StaticObstacle, ...], grasps: str
) -> None:
    found = solve(behind(walls, -3.1), "object_00", grasps=grasps)
    assert isinstance(found, Solution), found


def test_out_of_a_closed_room_the_refusal_says_that_the_base_has_no_way() -> None:
    found = solve(behind((*ROOM, DOOR)), "object_00")
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.NO_WAY_FOR_BASE
    assert "object_00" in found.detail
    assert found.stats.replans == 0


@pytest.mark.slow
def test_it_says_the_same_where_the_base_fits_and_the_robot_does_not() -> None:
    bar = StaticObstacle("bar", np.array([-1.8, 0.0, 1.1]), np.array([0.05, 0.6, 0.1]))
    found = solve(behind((*ROOM, bar)), "object_00")
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.NO_WAY_FOR_BASE
    assert found.stats.replans < 30
