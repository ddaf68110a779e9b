"""Picking up and putting down: joined motions, held objects, mirrored placements, reasons."""

from __future__ import annotations

import numpy as np
import pytest

from assets.robots import FETCH
from planners.collision.world import STEP, CollisionWorld
from planners.motion.approaches import can_put_down, planned_approach
from planners.motion.arm import tcp_pose
from planners.motion.mujoco_check import TOLERANCE, MujocoCollisionChecker
from planners.motion.path import BlockedBy
from planners.motion.pick_and_place import PickPlaceMotion, plan_pick, plan_place
from planners.scene import HeldObject, RobotState, UnknownObject
from tests.planners.motion_scenes import grasp_configurations, mixed_scene
from tests.planners.scenes import cylinder, table_scene

HOME = np.array(FETCH.home)


def picks(seed: int, count: int = 15) -> list[tuple[CollisionWorld, PickPlaceMotion]]:
    """Motions for the standing objects of a scene that can be had."""
    world = CollisionWorld.from_scene(mixed_scene(count, seed))
    rng = np.random.default_rng(seed)
    found = []
    for body in world.scene.objects:
        for base, q in grasp_configurations(world, body.name, rng) if body.is_upright else []:
            motion = plan_pick(world, base, HOME, q, body.name, rng=rng)
            if isinstance(motion, PickPlaceMotion):
                found.append((world, motion))
        if len(found) == 5:
            break
    return found


@pytest.fixture(scope="module")
def motions() -> list[tuple[CollisionWorld, PickPlaceMotion]]:
    found = picks(0)
    assert len(found) >= 4
    return found


def test_picks_are_joined_free_and_end_in_the_carry_configuration(
    motions: list[tuple[CollisionWorld, PickPlaceMotion]],
) -> None:
    for world, motion in motions:
        checker = MujocoCollisionChecker(world.scene)
        for before, after in zip(motion.paths[:-1], motion.paths[1:], strict=True):
            assert np.allclose(before.end, after.start)
        for path in motion.paths:
            assert checker.deepest_penetration(path, step=STEP).penetration <= TOLERANCE
        assert np.allclose(motion.transit.start, HOME)
        assert np.allclose(np.exp(1j * motion.retreat.end), np.exp(1j * HOME))
        assert [path.held is not None for path in motion.paths] == [False, False, True, True]


def test_the_object_is_taken_where_the_scene_has_it(
    motions: list[tuple[CollisionWorld, PickPlaceMotion]],
) -> None:
    for world, motion in motions:
        T_world_tcp = tcp_pose(FETCH, RobotState(motion.departure.base, motion.departure.start, 0.0))
        assert np.allclose(T_world_tcp @ motion.held.T_tcp_object, world.scene.body(motion.body.name).pose)


def test_what_was_picked_can_be_put_back(motions: list[tuple[CollisionWorld, PickPlaceMotion]]) -> None:
    rng = np.random.default_rng(0)
    for world, motion in motions:
        base, q = motion.departure.base, motion.departure.start
        assert planned_approach(world, base, q, motion.body.name)
        place = plan_place(world, base, motion.retreat.end, q, motion.held, rng=rng)
        assert isinstance(place, PickPlaceMotion)
        assert can_put_down(world, base, q, motion.held)
        assert np.allclose(place.body.pose, world.scene.body(motion.body.name).pose, atol=1e-9)
        for before, after in zip(place.paths[:-1], place.paths[1:], strict=True):
            assert np.allclose(before.end, after.start)
        loaded, empty = MujocoCollisionChecker(world.scene), MujocoCollisionChecker(world.scene.with_body(place.body))
        for path in place.paths:
            assert (loaded if path.held else empty).deepest_penetration(path, step=STEP).penetration <= TOLERANCE


def test_neighbours_that_leave_no_room_are_named() -> None:
    crowd = (
        cylinder("object_00", -0.15, 0.0),
        cylinder("object_01", -0.15, 0.075),
        cylinder("object_02", -0.15, -0.075),
    )
    alone = CollisionWorld.from_scene(table_scene(crowd[0]))
    world = CollisionWorld.from_scene(table_scene(*crowd))
    named = set()
    for base, q in grasp_configurations(alone, "object_00", np.random.default_rng(0), count=6):
        found = plan_pick(world, base, HOME, q, "object_00", rng=np.random.default_rng(0))
        if isinstance(found, BlockedBy):
            named |= found.blockers
            free = plan_pick(
                world, base, HOME, q, "object_00", rng=np.random.default_rng(0), ignore=world.scene.mask(found.blockers)
            )
            assert isinstance(free, PickPlaceMotion)
    assert named
    assert named <= {"object_01", "object_02"}


def test_unknown_objects_are_misuse() -> None:
    world = CollisionWorld.from_scene(table_scene(cylinder("object_00", 0.0, 0.0)))
    rng = np.random.default_rng(0)
    with pytest.raises(UnknownObject, match="object_00"):
        plan_pick(world, np.zeros(3), HOME, HOME, "cup", rng=rng)
    with pytest.raises(UnknownObject, match="object_00"):
        plan_place(world, np.zeros(3), HOME, HOME, HeldObject("cup", np.eye(4)), rng=rng)
