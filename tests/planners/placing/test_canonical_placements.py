"""Canonical placements: cells of a fixed grid, the base straight before them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from planners.clearing.commitments import grasped
from planners.collision.world import CollisionWorld
from planners.context import PlanningContext
from planners.placing.canonical import CanonicalPlacements, placement_cells
from planners.placing.surfaces import KeepClear
from planners.scene import Scene
from planners.strategies import STRATEGIES
from tests.planners.scenes import cylinder, random_scene, table_scene

LOOKAHEAD = STRATEGIES["lookahead"]


def in_hand(scene: Scene) -> Scene:
    return grasped(
        scene,
        PlanningContext.of(scene.robot, scene, grasps="side", canonical=True)
        .grasps()
        .for_object(scene, "object_00")[0],
    )


def test_cells_are_a_grid_inside_the_margins() -> None:
    support = table_scene(cylinder("object_00", 0.0, 0.0)).support
    cells = placement_cells(support)
    assert np.allclose(cells.mean(axis=0)[:2], support.position[:2])
    assert (np.abs(cells[:, :2] - support.position[:2]) <= support.extent[:2] - 0.045 + 1e-9).all()
    assert np.allclose(cells[:, 2], support.top)
    for axis in (0, 1):
        assert np.allclose(np.diff(np.unique(cells[:, axis].round(9))), 0.05)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_first_placements_are_straight_on_cells_and_do_not_depend_on_random_numbers(seed: int) -> None:
    scene = in_hand(random_scene(8, seed))
    world, search = (
        CollisionWorld.from_scene(scene),
        PlanningContext.of(scene.robot, scene, grasps="side", canonical=True).placements(),
    )
    found = [
        list(itertools.islice(search.find(world, KeepClear(), LOOKAHEAD, np.random.default_rng(rng)), 3))
        for rng in (0, 1)
    ]
    for one, other in zip(*found, strict=True):
        assert np.array_equal(one.base, other.base)
        assert np.array_equal(one.q, other.q)
        assert abs(np.remainder(one.yaw - one.base[2] + np.pi, 2 * np.pi) - np.pi) < 1e-9
        assert np.linalg.norm(placement_cells(scene.support)[:, :2] - one.location, axis=1).min() < 1e-6


def test_where_no_cell_is_straight_the_placements_of_the_paper_follow(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = in_hand(random_scene(8, 1))
    world, search = (
        CollisionWorld.from_scene(scene),
        PlanningContext.of(scene.robot, scene, grasps="side", canonical=True).placements(),
    )
    monkeypatch.setattr(CanonicalPlacements, "straight", lambda *_: iter(()))
    assert next(search.find(world, KeepClear(), LOOKAHEAD, np.random.default_rng(0)), None) is not None
