"""Whole plans in the user's own scene: they keep clear of everything that is not movable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from assets.robots import FETCH
from planners import Solution, solve
from planners.grasping.base_placement import free_ground
from planners.placing.negative_goal_region import SupportGrid
from planners.placing.surfaces import static_mask
from planners.scene import Scene, SceneError, StaticObstacle
from tests.planners.own_scenes import MOVABLE, SUPPORT, TABLE_X, TOP, deepest, kitchen, read
from tests.planners.scenes import table_scene

CLOSE = 0.001
"""[m] Penetration that is allowed."""
BESIDE = 'pos="1.055 0.19 0.95"'
"""Where the wrist is when a plan that knows nothing of the pillar takes the can."""
PILLARS = {
    "cylinder": f'<geom name="pillar" type="cylinder" size="0.03 0.2" {BESIDE}/>',
    "capsule": f'<geom name="pillar" type="capsule" size="0.03 0.2" {BESIDE}/>',
    "turned box": f'<geom name="pillar" type="box" size="0.03 0.04 0.2" {BESIDE} euler="0.1 0 0.7"/>',
    "ellipsoid": f'<geom name="pillar" type="ellipsoid" size="0.04 0.05 0.2" {BESIDE}/>',
    "mesh": '<geom name="pillar" type="mesh" mesh="wedge" pos="1.055 0.19 0.85" euler="0 0 0.3"/>',
    "other bits": f'<geom name="pillar" type="cylinder" size="0.03 0.2" {BESIDE} contype="8" conaffinity="8"/>',
    "free body": f'<body {BESIDE}><freejoint/><geom name="pillar" type="box" size="0.03 0.03 0.2" mass="1"/></body>',
    "two bodies": '<body pos="1.055 0.19 0.84"><geom name="pillar" type="cylinder" size="0.03 0.1"/>'
    '<body pos="0 0 0.2"><joint axis="0 0 1"/><geom name="arm" type="capsule" size="0.02 0.1" euler="1.57 0 0"/>'
    "</body></body>",
}


@pytest.mark.parametrize(
    "kind", [kind if kind in ("mesh", "two bodies") else pytest.param(kind, marks=pytest.mark.slow) for kind in PILLARS]
)
def test_a_plan_keeps_clear_of_a_pillar_beside_the_target(kind: str) -> None:
    model, data = kitchen(PILLARS[kind])
    scene = read(model, data)
    found = solve(scene, "can", rng=np.random.default_rng(0))
    assert isinstance(found, Solution), found
    geoms = ["pillar", "plate", "leg", "left_wall", "right_wall", "back_wall", *["arm"][: kind == "two bodies"]]
    assert deepest(model, found, geoms)[0] <= CLOSE
    blind = Scene.from_mujoco(
        model, data, FETCH, movable=MOVABLE, support=SUPPORT, obstacles=lambda geom: geom.name not in ("pillar", "arm")
    )
    careless = solve(blind, "can", rng=np.random.default_rng(0))
    assert isinstance(careless, Solution), careless
    assert deepest(model, careless, ("pillar",))[0] > 0.01


def test_a_scene_whose_support_is_missing_lists_what_could_be_one() -> None:
    scene = replace(table_scene(), supports=("desk",))
    ball = StaticObstacle("desk", np.array([0.0, 0.0, 0.5]), np.full(3, 0.2), "sphere")
    for own in (scene, replace(scene, static_obstacles=(*scene.static_obstacles, ball))):
        with pytest.raises(SceneError, match=r"'desk'.*table_top \(0.75 m\), counter_left"):
            _ = own.support


def test_obstacles_on_the_support_leave_no_place_to_put_things() -> None:
    model, data = kitchen(f'<geom name="pillar" type="cylinder" size="0.05 0.2" pos="{TABLE_X} 0.3 {TOP + 0.2}"/>')
    scene = read(model, data)
    grid = SupportGrid.over(scene.support)
    mask, away = static_mask(scene, scene.support, grid, 0.2), np.linalg.norm(grid.centres() - (TABLE_X, 0.3), axis=-1)
    assert mask[away < 0.05].all()
    assert not mask[away > 0.05 * 1.5].any()
    lamp = StaticObstacle("lamp", np.array([TABLE_X, 0.0, TOP + 0.5]), np.full(3, 0.1), "sphere")
    hung = replace(scene, static_obstacles=(*scene.static_obstacles, lamp))
    assert np.array_equal(static_mask(hung, hung.support, grid, 0.2), mask)
    assert static_mask(hung, hung.support, grid, 0.6).sum() > mask.sum()


@pytest.mark.parametrize("layout", [(), ("flush",)])
def test_what_is_level_with_the_table_or_beside_it_covers_none_of_it(layout: tuple[str, ...]) -> None:
    scene = table_scene()
    if layout:
        flush = StaticObstacle("flush", np.array([0.0, 0.0, 0.7505 - 0.02]), np.array([0.1, 0.1, 0.02]))
        scene = replace(scene, static_obstacles=(*scene.static_obstacles, flush))
    grid = SupportGrid.over(scene.support)
    assert not static_mask(scene, scene.support, grid, 0.25, 0.006)[:-2].any()
    assert not static_mask(scene, scene.support, grid, 0.25).any()


def test_nothing_is_put_beyond_the_edge_of_a_round_or_turned_table() -> None:
    scene, c, s = table_scene(), np.cos(0.4), np.sin(0.4)
    turned = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    tables = (
        StaticObstacle("table_top", np.array([0.0, 0.0, 0.73]), np.array([0.4, 0.4, 0.02]), "cylinder"),
        StaticObstacle("table_top", np.array([0.0, 0.0, 0.73]), np.array([0.3, 0.5, 0.02]), "box", turned),
    )
    for table in tables:
        own = replace(scene, static_obstacles=(table,))
        grid = SupportGrid.over(own.support)
        free = ~static_mask(own, own.support, grid, 0.2)
        corners = grid.centres()[free][:, None] + 0.5 * grid.resolution * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        assert table.is_under(corners).all()
        area = np.pi * 0.4**2 if table.shape == "cylinder" else 0.6 * 1.0
        assert free.sum() * grid.resolution**2 == pytest.approx(area, rel=0.04)


def test_the_base_keeps_off_the_outlines_at_its_own_height() -> None:
    model, data = kitchen(
        '<geom name="column" type="cylinder" size="0.1 1" pos="-0.8 0 1" euler="0.4 0 0"/>'
        '<geom name="slab" type="box" size="5 5 0.05" pos="0 0 -0.05"/>'
        '<geom name="ceiling" type="box" size="5 5 0.05" pos="0 0 2.6"/>'
    )
    scene = read(model, data)
    floor = free_ground(scene)
    assert floor.is_free(0.0, 0.0)
    assert not floor.is_free(TABLE_X, 0.4)
    assert not floor.is_free(0.0, 0.7)
    column = data.geom("column")
    ends = [column.xpos + side * column.xmat.reshape(3, 3)[:, 2] for side in (-1, 1)]
    for share in np.linspace(0, 1, 5):
        x, y, _ = ends[0] + share * (ends[1] - ends[0])
        for angle in np.linspace(0, 2 * np.pi, 8):
            reach = 0.09 + FETCH.base_radius
            assert not floor.is_free(x + reach * np.cos(angle), y + reach * np.sin(angle))
