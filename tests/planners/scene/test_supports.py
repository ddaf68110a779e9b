"""Objects stand on their own supports: tables of different heights, boards, the floor; and may be taken from each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from assets.robots import FETCH
from planners import Planner, Scene, Solution, StaticObstacle, clearance_floor, solve
from planners.motion.mujoco_check import MujocoCollisionChecker
from planners.scene import FLOOR, Body, RobotState
from tests.planners.own_scenes import KITCHEN, SUPPORT, kitchen

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def _table(name: str, y: float, top: float) -> StaticObstacle:
    return StaticObstacle(name, np.array([0.0, y, top - 0.02]), np.array([0.3, 0.4, 0.02]))


def _can(name: str, x: float, y: float, level: float) -> Body:
    return Body(name, "cylinder", np.array([0.03, 0.03, 0.08]), np.array([x, y, level + 0.08]), UPRIGHT)


def _scene(objects: tuple[Body, ...], *tables: StaticObstacle) -> Scene:
    state = RobotState(np.array([-1.1, 0.0, 0.0]), np.array(FETCH.home), FETCH.max_finger_position)
    return Scene(FETCH, state, objects, tables, supports=tuple(table.name for table in tables))


HIGH, LOW, FAR = _table("high", 0.0, 0.74), _table("low", 1.0, 0.70), _table("far", 4.0, 0.60)
BOARD = StaticObstacle("board", np.array([0.0, 0.0, 1.1]), np.array([0.3, 0.4, 0.01]))


def test_an_object_stands_on_the_highest_level_top_below_it_or_on_the_floor() -> None:
    scene = _scene((), HIGH, LOW, BOARD)
    for body, support in (
        (_can("a", 0.0, 0.1, 0.74), "high"),
        (_can("a", 0.0, 1.0, 0.70), "low"),
        (_can("a", 0.0, 0.0, 1.11), "board"),
        (_can("a", 0.0, 0.0, 0.0), FLOOR),
        (_can("a", -0.6, 0.0, 0.0), FLOOR),
        (_can("a", -0.6, 0.0, 0.8), FLOOR),
    ):
        under = scene.support_under(body)
        assert under.name == support
        assert under.top <= body.bottom + 0.02


@pytest.mark.parametrize("place", [LOW, FAR, None], ids=lambda table: table.name if table else FLOOR)
def test_what_stands_lower_than_the_first_support_is_taken_all_the_same(place: StaticObstacle | None) -> None:
    wanted = _can("wanted", -0.1, place.position[1], place.top) if place else _can("wanted", -0.6, 0.9, 0.0)
    scene = _scene((_can("other", -0.1, 0.0, 0.74), wanted), HIGH, LOW, FAR)
    assert clearance_floor(scene, "wanted").count == 0
    found = solve(scene, "wanted", rng=np.random.default_rng(0))
    assert isinstance(found, Solution), found
    for action in found.actions:
        checker = MujocoCollisionChecker(action.scene)
        assert checker.deepest_penetration(action.trajectory).penetration < 0.001


def test_from_under_a_table_the_base_drives_out_with_what_stood_on_the_floor() -> None:
    scene = _scene((_can("wanted", -0.1, 0.0, 0.0),), HIGH)
    found = solve(scene, "wanted", rng=np.random.default_rng(0))
    assert isinstance(found, Solution), found
    end = found.actions[-1].trajectory.base[-1]
    assert not HIGH.is_under(end[:2])


def test_the_floor_is_a_support_where_there_is_no_other_or_by_its_name() -> None:
    bare = replace(_scene((_can("a", -0.4, 0.5, 0.0),)), supports=())
    assert isinstance(Planner(FETCH).solve(bare, "a"), Solution)
    assert bare.support.name == bare.support_named(FLOOR).name == FLOOR
    assert Planner(FETCH, supports=("high", FLOOR)).workspace(_scene((), HIGH)).supports == ("high", FLOOR)
    model, data = kitchen()
    assert "ground" in KITCHEN
    read = Scene.from_mujoco(model, data, FETCH, movable=(), support=SUPPORT, more_supports=(FLOOR,))
    assert read.supports == ("plate", FLOOR)


def test_of_a_bin_its_floor_is_the_support_and_not_the_rim() -> None:
    walls = "".join(
        f'<geom type="box" size="{a} {b} 0.05" pos="{x} {y} 0.06"/>'
        for a, b, x, y in ((0.1, 0.005, 0, 0.1), (0.1, 0.005, 0, -0.1), (0.005, 0.1, 0.1, 0), (0.005, 0.1, -0.1, 0))
    )
    crate = f'<body name="crate" pos="0.9 0.3 0.75"><geom name="bottom" type="box" size="0.1 0.1 0.01"/>{walls}</body>'
    model, data = kitchen(crate)
    scene = Scene.from_mujoco(model, data, FETCH, movable=["can"], support=SUPPORT, more_supports=["crate"])
    assert scene.supports == ("plate", "bottom")
