"""Picking up and putting down, on the table and under a shelf: joined motions, mirrored placements, reasons."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import pytest

from assets.robots import FETCH
from planners import Planner, Solution
from planners.collision.world import CollisionWorld
from planners.goals import LIFTED
from planners.motion.approaches import can_put_down, fewest_blockers, planned_approach, stand_off
from planners.motion.arm import ArmQuery, tcp_pose
from planners.motion.mujoco_check import TOLERANCE, MujocoCollisionChecker
from planners.motion.path import BlockedBy
from planners.motion.pick_and_place import PickPlaceMotion, _held_heights, plan_pick, plan_place
from planners.motion.timing import pick_trajectory, place_trajectory
from planners.scene import HeldObject, RobotState, Scene, UnknownObject
from planners.workspace import Workspace
from tests.planners.motion_scenes import grasp_configurations, mixed_scene
from tests.planners.scenes import cylinder, random_shelf, shelf_scene, table_scene

HOME, BASE = np.array(FETCH.home), np.array([-0.9, 0.1, 0.3])
PLANNER = Planner(FETCH, grasps="side")
STEP = 0.005
Picks = list[tuple[Scene, PickPlaceMotion]]


def on_the_table() -> Iterator[tuple[Scene, PickPlaceMotion]]:
    """Motions for the standing objects of a scene that can be had."""
    scene, rng = mixed_scene(15, 0), np.random.default_rng(0)
    world = CollisionWorld.from_scene(scene)
    for body in scene.objects:
        for base, q in grasp_configurations(world, body.name, rng) if body.is_upright else []:
            motion = plan_pick(world, base, HOME, q, body.name, rng=rng)
            if isinstance(motion, PickPlaceMotion):
                yield scene, motion


def under_a_shelf() -> Iterator[tuple[Scene, PickPlaceMotion]]:
    """The first grasp that works of an object at each of some places."""
    for place in ((-0.2, 0.3), (0.0, -0.1), (0.15, 0.2), (0.25, -0.35)):
        scene = shelf_scene(cylinder("object_00", *place))
        world, rng = CollisionWorld.from_scene(scene), np.random.default_rng(0)
        for grasp in Workspace.of(scene.robot, scene, grasps="side").grasps().for_object(scene, "object_00"):
            assert grasp.drives
            start = np.concatenate((stand_off(scene, grasp.base, grasp.q, scene.body("object_00")), scene.state.q))
            motion = plan_pick(world, grasp.base, start, grasp.q, "object_00", rng=rng)
            if isinstance(motion, PickPlaceMotion):
                yield scene, motion
                break


@pytest.fixture(scope="module")
def shelf_picks() -> Picks:
    found = list(under_a_shelf())
    assert len(found) == 4
    return found


@pytest.fixture(scope="module", params=["table", "shelf"])
def picks(request: pytest.FixtureRequest, shelf_picks: Picks) -> Picks:
    return shelf_picks if request.param == "shelf" else list(itertools.islice(on_the_table(), 5))


def assert_joined_and_free(motion: PickPlaceMotion, loaded: Scene, empty: Scene) -> None:
    checkers = {True: MujocoCollisionChecker(loaded), False: MujocoCollisionChecker(empty)}
    for before, after in itertools.pairwise(motion.paths):
        assert np.allclose(before.configurations[-1], after.configurations[0], atol=1e-3)
    for path in motion.paths:
        assert checkers[path.held is not None].deepest_penetration(path, step=STEP).penetration <= TOLERANCE


def test_picks_are_joined_and_free_and_take_the_object_where_it_is(picks: Picks) -> None:
    assert len(picks) >= 4
    for scene, motion in picks:
        assert_joined_and_free(motion, scene, scene)
        assert np.allclose(motion.transit.configurations[0, 3:], HOME)
        assert [path.held is not None for path in motion.paths] == [False, False, True, True]
        T_world_tcp = tcp_pose(FETCH, RobotState(*np.split(motion.departure.configurations[0], [3]), 0.0))
        assert np.allclose(T_world_tcp @ motion.held.T_tcp_object, scene.body(motion.body.name).pose)


def test_what_was_picked_can_be_put_back(picks: Picks) -> None:
    for scene, motion in picks:
        world, (base, q) = CollisionWorld.from_scene(scene), np.split(motion.departure.configurations[0], [3])
        assert planned_approach(world, base, q, motion.body.name)
        assert can_put_down(world, base, q, motion.held)
        start = motion.retreat.configurations[-1]
        place = plan_place(world, base, start, q, motion.held, rng=np.random.default_rng(0))
        assert isinstance(place, PickPlaceMotion), place
        assert np.allclose(place.body.pose, scene.body(motion.body.name).pose, atol=1e-9)
        assert_joined_and_free(place, scene, scene.with_body(place.body))
        assert place_trajectory(world, place, RobotState(start[:3], start[3:], 0.02)).held == ""


def test_on_the_table_a_pick_ends_at_home() -> None:
    _, motion = next(on_the_table())
    assert np.allclose(np.exp(1j * motion.retreat.end), np.exp(1j * HOME))


def test_under_a_shelf_the_base_drives_and_the_arm_is_rigid_then(shelf_picks: Picks) -> None:
    for _, motion in shelf_picks:
        for path in (motion.approach, motion.departure):
            moves = np.abs(np.diff(path.configurations, axis=0))
            assert not (moves[:, :3].any(axis=1) & (moves[:, 3:] > 1e-12).any(axis=1)).any()
            assert np.linalg.norm(path.end_base - path.configurations[0, :3]) > 0.2


def test_the_end_of_a_pick_holds_the_object_as_high_as_counts_as_lifted(shelf_picks: Picks) -> None:
    for scene, motion in shelf_picks:
        trajectory = pick_trajectory(CollisionWorld.from_scene(scene), motion, scene.state)
        assert trajectory.held == "object_00"
        assert np.allclose(trajectory.base[-1], motion.retreat.end_base)
        body = scene.body("object_00")
        T_world_tcp = tcp_pose(FETCH, RobotState(motion.retreat.end_base, motion.retreat.end, 0.0))
        assert body.at_pose(T_world_tcp @ motion.held.T_tcp_object).bottom - body.bottom > LIFTED


def test_a_target_too_high_for_the_home_configuration_is_carried_high() -> None:
    boards = [obstacle for obstacle in shelf_scene().static_obstacles if obstacle.name == "shelf_board"]
    on_board = cylinder("object_00", -0.15, 0.1).at((-0.15, 0.1, boards[0].top + 0.08))
    scene = shelf_scene(on_board)
    found = PLANNER.solve(scene, "object_00")
    assert isinstance(found, Solution), found
    last = found.actions[-1].trajectory
    end = scene.with_state(RobotState(last.base[-1], last.q[-1], 0.0))
    assert end.state.q[0] > 0.0
    assert last.phases[-1].touched is not None
    held = scene.body("object_00").at_pose(tcp_pose(FETCH, end.state) @ last.phases[-1].touched.T_tcp_object)
    assert held.bottom > on_board.bottom + LIFTED


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


def test_grasps_know_what_is_in_the_way_out() -> None:
    front, behind = cylinder("object_00", -0.25, 0.0), cylinder("object_01", -0.1, 0.0)
    walls = [cylinder(f"object_{2 + i:02d}", -0.25, y) for i, y in enumerate((-0.3, -0.2, -0.1, 0.1, 0.2, 0.3))]
    scene = shelf_scene(front, behind, *walls)
    world, candidates = CollisionWorld.from_scene(scene), Workspace.of(scene.robot, scene, grasps="side").grasps()
    walled_in = candidates.for_object(scene, "object_01")
    assert walled_in
    for grasp in walled_in:
        assert grasp.blockers
    free = candidates.for_object(scene, "object_00")[0]
    assert not free.blockers
    assert fewest_blockers(world, free.base, free.q, "object_00") == 0
    in_hand = CollisionWorld.from_scene(scene.with_held(HeldObject("object_00", np.eye(4))))
    hits = [[fewest_blockers(one, grasp.base, grasp.q, "object_01") for one in (world, in_hand)] for grasp in walled_in]
    assert any(standing & 1 for standing, _ in hits if standing is not None)
    assert not any(held & 1 for _, held in hits if held is not None), "it is put down before anything is taken"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_cluttered_shelves_are_solved_and_nothing_is_cleared_twice(seed: int) -> None:
    scene = random_shelf(12, seed)
    for target in scene.names[:4]:
        floor = PLANNER.clearance_floor(scene, target)
        found = PLANNER.solve(scene, target)
        assert isinstance(found, Solution) == (floor.count is not None), (target, found)
        if isinstance(found, Solution):
            assert not found.duplicated
            assert floor.count is not None
            assert len(found.clearances) <= floor.count + 1


def test_the_held_object_is_as_high_as_its_lowest_point() -> None:
    scene, rng = mixed_scene(8, 0), np.random.default_rng(0)
    Q = np.array(HOME) + rng.normal(size=(10, 8)) * 0.4
    for body in scene.objects:
        T = np.eye(4)
        T[:3, :3] = scene.objects[3].rotation
        held = HeldObject(body.name, T)
        query = ArmQuery(CollisionWorld.from_scene(scene), BASE, 0.05, held)
        poses = [tcp_pose(FETCH, RobotState(BASE, q, 0.0)) @ T for q in Q]
        assert np.allclose(_held_heights(query, Q), [body.at_pose(pose).bottom for pose in poses], atol=1e-9)
