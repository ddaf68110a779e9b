"""Laws of picks and placements under a shelf: the base drives in and out, the arm rigid, and nothing is touched."""

from __future__ import annotations

import numpy as np
import pytest

from assets.robots import FETCH
from planners import Planner, Solution
from planners.collision.world import CollisionWorld
from planners.context import PlanningContext
from planners.motion.approaches import fewest_blockers, stand_off
from planners.motion.arm import tcp_pose
from planners.motion.mujoco_check import TOLERANCE, MujocoCollisionChecker
from planners.motion.pick_and_place import LIFTED, PickPlaceMotion, plan_pick, plan_place
from planners.motion.timing import pick_trajectory, place_trajectory
from planners.scene import RobotState, Scene
from tests.planners.scenes import cylinder, random_shelf, shelf_scene

PLANNER = Planner(FETCH, grasps="side")
PLACES = ((-0.2, 0.3), (0.0, -0.1), (0.15, 0.2), (0.25, -0.35))
STEP = 0.005


def picks() -> list[tuple[Scene, PickPlaceMotion]]:
    """The first grasp that works of an object at each of some places."""
    found = []
    for x, y in PLACES:
        scene = shelf_scene(cylinder("object_00", x, y))
        world, rng = CollisionWorld.from_scene(scene), np.random.default_rng(0)
        for grasp in PlanningContext.of(scene.robot, scene, grasps="side").grasps().for_object(scene, "object_00"):
            assert grasp.drives
            start = np.concatenate((stand_off(scene, grasp.base, grasp.q), scene.state.q))
            motion = plan_pick(world, grasp.base, start, grasp.q, "object_00", rng=rng)
            if isinstance(motion, PickPlaceMotion):
                found.append((scene, motion))
                break
    return found


@pytest.fixture(scope="module")
def motions() -> list[tuple[Scene, PickPlaceMotion]]:
    found = picks()
    assert len(found) == len(PLACES)
    return found


def test_picks_drive_with_a_rigid_arm_and_touch_nothing(motions: list[tuple[Scene, PickPlaceMotion]]) -> None:
    for scene, motion in motions:
        checker = MujocoCollisionChecker(scene)
        for before, after in zip(motion.paths[:-1], motion.paths[1:], strict=True):
            assert np.allclose(before.configurations[-1], after.configurations[0], atol=1e-3)
        for path in motion.paths:
            assert checker.deepest_penetration(path, step=STEP).penetration <= TOLERANCE
        for path in (motion.approach, motion.departure):
            moves = np.abs(np.diff(path.configurations, axis=0))
            assert not (moves[:, :3].any(axis=1) & (moves[:, 3:] > 1e-12).any(axis=1)).any()
            assert np.linalg.norm(path.end_base - path.base) > 0.2


def test_the_end_of_a_pick_holds_the_object_as_high_as_counts_as_lifted(
    motions: list[tuple[Scene, PickPlaceMotion]],
) -> None:
    for scene, motion in motions:
        trajectory = pick_trajectory(FETCH, motion, scene.state)
        assert trajectory.held == "object_00"
        assert np.allclose(trajectory.base[-1], motion.retreat.end_base)
        assert _lift(scene, motion, motion.retreat.configurations[-1]) > LIFTED


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
    T = _tcp(end)
    held = scene.body("object_00").at_pose(T @ last.phases[-1].touched.T_tcp_object)
    assert held.bottom > on_board.bottom + LIFTED


def test_what_was_picked_can_be_put_back_from_outside(motions: list[tuple[Scene, PickPlaceMotion]]) -> None:
    for scene, motion in motions:
        world, rng = CollisionWorld.from_scene(scene), np.random.default_rng(0)
        start = motion.retreat.configurations[-1]
        base, q = motion.approach.end_base, motion.approach.end
        place = plan_place(world, base, start, q, motion.held, rng=rng)
        assert isinstance(place, PickPlaceMotion), place
        assert np.allclose(place.body.pose, scene.body("object_00").pose, atol=1e-9)
        loaded, empty = MujocoCollisionChecker(scene), MujocoCollisionChecker(scene.with_body(place.body))
        for path in place.paths:
            assert (loaded if path.held else empty).deepest_penetration(path, step=STEP).penetration <= TOLERANCE
        state = RobotState(start[:3], start[3:], 0.02)
        assert place_trajectory(FETCH, place, state).held == ""


def test_grasps_know_what_is_in_the_way_out() -> None:
    front, behind = cylinder("object_00", -0.25, 0.0), cylinder("object_01", -0.1, 0.0)
    walls = [cylinder(f"object_{2 + i:02d}", -0.25, y) for i, y in enumerate((-0.3, -0.2, -0.1, 0.1, 0.2, 0.3))]
    scene = shelf_scene(front, behind, *walls)
    world, candidates = CollisionWorld.from_scene(scene), PlanningContext.of(scene.robot, scene, grasps="side").grasps()
    walled_in = candidates.for_object(scene, "object_01")
    assert walled_in
    for grasp in walled_in:
        assert grasp.blockers
    free = candidates.for_object(scene, "object_00")[0]
    assert not free.blockers
    assert fewest_blockers(world, free.base, free.q, "object_00") == 0


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


def _tcp(scene: Scene) -> np.ndarray:
    return tcp_pose(scene.robot, scene.state)


def _lift(scene: Scene, motion: PickPlaceMotion, x: np.ndarray) -> float:
    """[m] of the held object in a whole-body configuration above where it stood."""
    body = scene.body("object_00")
    T = _tcp(scene.with_state(RobotState(x[:3], x[3:], 0.0)))
    return body.at_pose(T @ motion.held.T_tcp_object).bottom - body.bottom
