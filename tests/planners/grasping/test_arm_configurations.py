"""Arm configurations reach the gripper poses asked for, at every pitch, and the gripper's own hits agree with them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from assets.robots import FETCH
from irm.chain import ArmChain
from planners.collision.world import CollisionWorld
from planners.grasping.arm_configurations import ConfigurationGrid, GripperPoses, gripper_hits, scan_configurations
from planners.grasping.base_placement import MapPlacer
from planners.motion.arm import tcp_pose
from planners.scene import SELF_BIT, RobotState, Scene
from tests.planners.scenes import random_scene

PITCHES = np.radians((0.0, 20.0, 40.0, 60.0, 90.0))
OPENING = 0.09
GRID = ConfigurationGrid.over(ArmChain.from_robot(FETCH), 4, 12)


def poses_over(scene: Scene, pitch: float) -> np.ndarray:
    """Gripper poses (k, 5) just above the objects of a scene, one for each."""
    positions = [(*body.position[:2], body.top + 0.03) for body in scene.objects]
    yaws = np.linspace(-1.0, 1.0, len(positions))
    return np.column_stack((positions, yaws, np.full(len(positions), pitch)))


def orientation(yaw: float, pitch: float) -> np.ndarray:
    """Rz(yaw) Ry(pitch), slowly."""
    cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    return np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]) @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return random_scene(15, 5)


@pytest.mark.parametrize("pitch", PITCHES)
def test_configurations_reach_the_gripper_pose_and_hits_are_those_of_the_collision_check(
    scene: Scene, pitch: float
) -> None:
    world, poses = CollisionWorld.from_scene(scene), poses_over(scene, pitch)
    bases, index = MapPlacer.of_scene(scene).bases(poses)
    assert len(set(index)) > len(poses) / 2, "most of these poses are within reach of some base"
    assert (np.diff(index) >= 0).all()
    found = scan_configurations(world, GripperPoses(bases, poses[index]), GRID, OPENING)
    assert len(found.q) > 0
    for q, pair, hits in zip(found.q, found.pair, found.hits, strict=True):
        wanted, base = poses[index[pair]], bases[pair]
        T = tcp_pose(FETCH, RobotState(base, q, 0.0))
        np.testing.assert_allclose(T[:3, 3], wanted[:3], atol=1e-6)
        np.testing.assert_allclose(T[:3, :3], orientation(*wanted[3:]), atol=1e-6)
        assert world.hits(base, q, OPENING) == hits
        by_gripper = int(gripper_hits(world, wanted[None], OPENING)[0])
        assert by_gripper & ~(1 << SELF_BIT) & ~int(hits) == 0


@pytest.mark.parametrize("pitch", [1.571, 1.7, -0.1])
def test_a_pitch_beyond_straight_down_or_above_level_has_bases(scene: Scene, pitch: float) -> None:
    """Release pitches are rounded, and what has slipped in the gripper is released at a pitch of its own."""
    poses = poses_over(scene, pitch)
    bases, index = MapPlacer.of_scene(scene).bases(poses)
    found = scan_configurations(CollisionWorld.from_scene(scene), GripperPoses(bases, poses[index]), GRID, OPENING)
    assert len(found.q) > 0


def test_bases_of_poses_with_several_pitches_are_those_of_each_pitch_alone(scene: Scene) -> None:
    placer = MapPlacer.of_scene(scene)
    mixed = np.concatenate([poses_over(scene, pitch)[:3] for pitch in PITCHES])[::-1]
    bases, index = placer.bases(mixed)
    for k, pose in enumerate(mixed):
        np.testing.assert_array_equal(bases[index == k], placer.bases(pose[None])[0])
    assert placer.bases(np.empty((0, 5)))[0].shape == (0, 3)
