"""Base poses that face the gripper."""

from __future__ import annotations

import numpy as np

from assets.robots import FETCH
from planners.context import map_placer
from planners.grasping.base_placement import TURNED, facing_bases, farthest_reach
from tests.planners.scenes import cylinder, table_scene

SCENE = table_scene(cylinder("object_00", 0.0, 0.0))
PLACER = map_placer(SCENE.robot, SCENE)
REACH = farthest_reach(FETCH)
YAWS = np.radians(np.arange(-90, 91, 15.0))
POSES = np.array([(x, y, 0.83, yaw, 0.0) for x in (-0.25, 0.1, 0.25) for y in (-0.3, 0.0) for yaw in YAWS])


def test_the_base_faces_the_gripper_with_its_yaw_from_the_nearest_free_ground_behind_the_standoff() -> None:
    bases, index = facing_bases(PLACER, POSES, REACH)
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
    bases, index = facing_bases(PLACER, POSES, REACH, TURNED)
    turns = POSES[index, 3] - bases[:, 2]
    assert {round(np.degrees(turn)) for turn in turns} == {-60, -40, -20, 20, 40, 60}
    cost = 0.5 * np.abs(bases[:, 2]) + np.abs(turns)
    assert (np.diff(cost) > -1e-6).all()


def test_no_gripper_pose_has_no_base() -> None:
    bases, index = facing_bases(PLACER, np.empty((0, 5)), REACH)
    assert bases.shape == (0, 3)
    assert index.shape == (0,)


def test_a_base_moves_little_when_the_gripper_does() -> None:
    line = np.column_stack((np.linspace(-0.3, 0.3, 121), np.full(121, 0.1), np.full(121, 0.83), np.zeros((121, 2))))
    bases, index = facing_bases(PLACER, line, REACH)
    ordered = bases[np.argsort(index)]
    assert len(ordered) > 100
    assert np.linalg.norm(np.diff(ordered[:, :2], axis=0), axis=1).max() < 0.0051 + 2e-4
