"""Base poses that face the gripper, outlines that are not round, and the map that comes with the package."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import assets
from assets.robots import FETCH, PR2
from irm import ReachabilityMap, cached_map
from irm.reachability_map import cache_file, is_map_at_hand, shipped_file
from planners.grasping.base_placement import (
    TURNED,
    MapPlacer,
    _outside_base,
    facing_bases,
    farthest_reach,
    fits,
    inner_radius,
    map_parameters,
)
from tests.planners.scenes import cylinder, table_scene

SCENE = table_scene(cylinder("object_00", 0.0, 0.0))
PLACER = MapPlacer.of_scene(SCENE)
REACH = farthest_reach(FETCH)
YAWS = np.radians(np.arange(-90, 91, 15.0))
POSES = np.array([(x, y, 0.83, yaw, 0.0) for x in (-0.25, 0.1, 0.25) for y in (-0.3, 0.0) for yaw in YAWS])


def test_the_base_faces_the_gripper_with_its_yaw_from_the_nearest_free_ground_behind_the_standoff() -> None:
    bases, index = facing_bases(PLACER, POSES)
    assert len(bases) > len(POSES) / 3
    for base, (x, y, _, yaw, _) in zip(bases, POSES[index], strict=True):
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        away = np.array([x, y]) - base[:2]
        distance = float(np.linalg.norm(away))
        np.testing.assert_allclose(away / distance, ahead, atol=1e-9)
        assert np.isclose(base[2], yaw)
        assert 0.75 - 1e-9 < distance < REACH
        assert PLACER.ground.is_free(*base[:2])
        nearer = base[:2] + 1e-3 * ahead
        assert distance < 0.75 + 1e-3 or not PLACER.ground.is_free(*nearer)


def test_turned_bases_have_all_the_relative_yaws_and_the_least_turned_comes_first() -> None:
    bases, index = facing_bases(PLACER, POSES, TURNED)
    turns = POSES[index, 3] - bases[:, 2]
    assert {round(np.degrees(turn)) for turn in turns} == {-60, -40, -20, 20, 40, 60}
    cost = 0.5 * np.abs(bases[:, 2]) + np.abs(turns)
    assert (np.diff(cost) > -1e-6).all()


def test_a_base_moves_little_when_the_gripper_does() -> None:
    line = np.column_stack((np.linspace(-0.3, 0.3, 121), np.full(121, 0.1), np.full(121, 0.83), np.zeros((121, 2))))
    bases, index = facing_bases(PLACER, line)
    ordered = bases[np.argsort(index)]
    assert len(ordered) > 100
    assert np.linalg.norm(np.diff(ordered[:, :2], axis=0), axis=1).max() < 0.0051 + 2e-4


TABLE = np.array([(-0.35, -0.5), (0.35, -0.5), (0.35, 0.5), (-0.35, 0.5)])
HALF = 0.334
"""[m] of PR2's square base."""


def test_the_inner_circle_touches_the_sides() -> None:
    assert inner_radius(PR2) == pytest.approx(HALF)
    assert inner_radius(FETCH) == FETCH.base_radius


def test_a_square_stands_nearer_with_a_side_than_with_a_corner_ahead() -> None:
    nearest, corner = -0.35 - HALF, -0.35 - HALF * np.sqrt(2.0)
    straight, turned = 0.0, np.pi / 4
    bases = np.array([(nearest - 0.021, 0, straight), (nearest - 0.019, 0, straight), (nearest - 0.021, 0, turned)])
    assert fits(PR2, bases, [TABLE], 0.02).tolist() == [True, False, False]
    bases = np.array([(corner - 0.021, 0, turned), (corner - 0.019, 0, turned), (0.0, 0.0, 0.0)])
    assert fits(PR2, bases, [TABLE], 0.02).tolist() == [True, False, False]


def test_what_fits_is_apart_and_what_does_not_is_near() -> None:
    """Against distances between points on the outlines."""
    rng = np.random.default_rng(0)
    bases = np.column_stack((rng.uniform(-1.3, -0.6, 200), rng.uniform(-1.2, 1.2, 200), rng.uniform(-3.2, 3.2, 200)))
    corners, table = _points(np.array(PR2.base_outline)), _points(TABLE)
    answers = fits(PR2, bases, [TABLE], 0.02)
    for base, answer in zip(bases, answers, strict=True):
        c, s = np.cos(base[2]), np.sin(base[2])
        placed = corners @ np.array([(c, s), (-s, c)]) + base[:2]
        distance = np.linalg.norm(placed[:, None] - table[None], axis=-1).min()
        if answer:
            assert distance > 0.02 - 1e-9
        else:
            assert distance < 0.02 * np.sqrt(2.0) + 0.01, "the margin is measured across the edges"


def _points(corners: np.ndarray, count: int = 60) -> np.ndarray:
    """Points along the edges of a polygon, the corners among them."""
    shares = np.linspace(0.0, 1.0, count, endpoint=False)[:, None]
    ends = np.roll(corners, -1, axis=0)
    return np.concatenate([a + shares * (b - a) for a, b in zip(corners, ends, strict=True)])


def test_it_is_loaded_and_not_built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The name of the file contains a digest of robot, parameters and format: after a change, ship another file."""
    monkeypatch.setenv("CLUTTER_ENV_CACHE", str(tmp_path))
    monkeypatch.setattr(ReachabilityMap, "build", None)
    assert is_map_at_hand(FETCH, **map_parameters(FETCH))
    assert len(cached_map(FETCH, **map_parameters(FETCH))) > 100_000
    assert not cache_file(FETCH, **map_parameters(FETCH)).exists()


def test_no_other_map_is_shipped() -> None:
    assert list(assets.folder("maps").iterdir()) == [shipped_file(FETCH, **map_parameters(FETCH))]


@pytest.mark.slow
def test_it_is_what_is_built() -> None:
    shipped = ReachabilityMap.load(shipped_file(FETCH, **map_parameters(FETCH)), FETCH)
    built = ReachabilityMap.build(FETCH, **map_parameters(FETCH))
    assert shipped.key == built.key
    for name in ("cells", "manipulability", "torso_index", "flags"):
        np.testing.assert_array_equal(getattr(shipped, name), getattr(built, name), err_msg=name)


@pytest.mark.parametrize("robot", [FETCH, PR2], ids=["round", "with corners"])
def test_how_far_a_point_is_outside_the_base_is_never_overestimated(robot: assets.RobotSpec) -> None:
    """A gripper that reaches low must be beside the base, not in it, whatever the base's yaw."""
    rng = np.random.default_rng(0)
    bases, points = rng.uniform(-1, 1, (500, 3)) * (1, 1, np.pi), rng.uniform(-1, 1, (500, 2))
    rim = np.array(robot.base_outline) if robot.base_outline else robot.base_radius * _circle()
    edge = np.concatenate([np.linspace(a, b, 50) for a, b in zip(rim, np.roll(rim, -1, axis=0), strict=True)])
    found = _outside_base(robot, bases, points)
    for base, point, away in zip(bases, points, found, strict=True):
        c, s = np.cos(base[2]), np.sin(base[2])
        true = np.linalg.norm(base[:2] + edge @ np.array([[c, s], [-s, c]]) - point, axis=1).min()
        assert abs(away) <= true + 1e-3
    assert 0 < (found < 0).mean() < 0.5


def _circle() -> np.ndarray:
    angles = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    return np.column_stack((np.cos(angles), np.sin(angles)))
