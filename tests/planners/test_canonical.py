"""Canonical plans: deterministic, smooth in the scene, at rest after every phase; other choices only where blocked."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from assets.robots import FETCH
from planners.clearing.commitments import grasped
from planners.collision.world import CollisionWorld
from planners.contact import Contact, contact_of, contacts, label_of
from planners.grasping.arm_configurations import GripperPoses
from planners.grasping.base_placement import STRAIGHT, facing_bases
from planners.grasping.candidates import GraspCandidate, GraspCandidates, _Stage, gripper_poses
from planners.grasping.families import SIDE
from planners.grasping.grasp_poses import generate_grasps
from planners.motion.arm import tcp_pose
from planners.motion.trajectory import CONTROL_STEP
from planners.placing.locations import placement_cells, rotated
from planners.placing.placements import PlacementSearch
from planners.placing.surfaces import KeepClear
from planners.planner import Planner
from planners.scene import RobotState, Scene
from planners.strategies import STRATEGIES
from planners.tamp.solution import Solution
from planners.workspace import Workspace
from tests.planners.scenes import cylinder, random_scene, table_scene

PLANNER = Planner(FETCH, grasps="side", canonical=True)


def solved(scene: Scene, target: str = "object_00", seed: int = 0) -> Solution:
    found = PLANNER.solve(scene, target, rng=np.random.default_rng(seed))
    assert isinstance(found, Solution)
    return found


@pytest.fixture(scope="module")
def plan() -> Solution:
    """A plan that clears something."""
    plans = (solved(random_scene(15, seed), "object_03") for seed in range(20))
    return next(plan for plan in plans if plan.clearances)


def canonical_workspace(scene: Scene) -> Workspace:
    return Workspace.of(scene.robot, scene, grasps="side", canonical=True)


def test_random_numbers_do_not_matter() -> None:
    scene = random_scene(12, 4)
    one, other = solved(scene, seed=0), solved(scene, seed=1)
    assert len(one.actions) == len(other.actions)
    for first, second in zip(one.actions, other.actions, strict=True):
        assert np.array_equal(first.trajectory.states, second.trajectory.states)


def test_every_phase_begins_and_ends_at_rest(plan: Solution) -> None:
    """The last step before a boundary is no longer than what the acceleration limits allow from rest."""
    most = np.array(FETCH.max_acceleration) * CONTROL_STEP**2
    for action in plan.actions:
        states = action.trajectory.states[:, :-1]
        for phase in action.trajectory.phases[1:]:
            k = round(phase.start / CONTROL_STEP)
            assert (np.abs(states[k] - states[k - 1]) <= most + 1e-9).all()
            assert (np.abs(states[k + 1] - states[k]) <= most + 1e-9).all()


def test_a_lone_object_is_taken_straight_ahead_and_the_plan_moves_little_when_it_does() -> None:
    found = [contacts(solved(table_scene(cylinder("object_00", x, 0.1))))[0] for x in np.arange(-0.2, 0.2, 0.02)]
    assert all(contact.is_straight for contact in found)
    assert all(abs(contact.base[2]) < 1e-9 for contact in found)
    bases = np.array([contact.base for contact in found])
    assert np.abs(np.diff(bases, axis=0)).max() < 0.021


def free_straight(source: GraspCandidates, scene: Scene, name: str) -> list[GraspCandidate]:
    """All straight grasps of an object in which nothing is hit, one for each direction."""
    body, grasps = scene.body(name), generate_grasps(scene.body(name), scene.robot)
    wanted = gripper_poses(grasps)
    bases, index = facing_bases(source.arms[scene.robot.arm_name], wanted)
    alone = [GripperPoses(base[None], pose[None]) for base, pose in zip(bases, wanted[index], strict=True)]
    source.for_object(scene, name)
    straight = _Stage(SIDE, STRAIGHT)
    found = [source._scan(scene, body, pose, grasps[0].opening, straight) for pose in alone]
    return [grasp for options in found for grasp in options if not grasp.blockers]


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 6))])
def test_other_grasps_are_chosen_only_where_all_straight_ones_are_blocked(seed: int) -> None:
    scene = random_scene(18, seed)
    source = canonical_workspace(scene).grasps()
    for name in scene.names:
        candidates = source.for_object(scene, name)
        is_straight_free = bool(free_straight(source, scene, name))
        assert is_straight_free == (
            bool(candidates) and not candidates[0].blockers and is_straight(scene, candidates[0])
        )


def is_straight(scene: Scene, grasp: GraspCandidate) -> bool:
    tcp = tcp_pose(scene.robot, RobotState(grasp.base, grasp.q, 0.0))
    return Contact("pick", grasp.object, grasp.base, tcp).is_straight


def test_a_banned_grasp_gives_way_to_the_next_straight_one_then_to_others() -> None:
    scene = table_scene(cylinder("object_00", 0.0, 0.0))
    source, offered = canonical_workspace(scene).grasps(), set()
    straight = {grasp.pair for grasp in free_straight(source, scene, "object_00")}
    while is_straight(scene, first := source.for_object(scene, "object_00")[0]):
        offered.add(first.pair)
        source.ban(scene, first)
    assert offered == straight
    assert first.blockers == 0


def test_a_plan_has_a_contact_for_every_grasp_and_release(plan: Solution) -> None:
    found = contacts(plan)
    assert [contact.skill for contact in found] == ["pick", "place"] * len(plan.clearances) + ["pick"]
    assert found[-1].object == plan.target
    assert all(contact_of(action) is None for action in plan.actions if action.name == "MoveBase")


def test_the_keyframe_is_where_the_phase_ends(plan: Solution) -> None:
    trajectory = plan.actions[-1].trajectory
    phases = trajectory.phases
    for phase, following in zip(phases, (*phases[1:], None), strict=True):
        label = label_of(trajectory, phase.start, None)
        at = -1 if following is None else round(following.start / CONTROL_STEP)
        assert label.phase == phase.name
        np.testing.assert_allclose(label.keyframe, trajectory.states[at], atol=1e-9)


@pytest.mark.parametrize("pitch", [0.0, 1.0, np.pi / 2])
@pytest.mark.parametrize("yaw", [-3.0, 0.0, 0.4])
def test_the_yaw_of_a_contact_is_the_grippers(yaw: float, pitch: float) -> None:
    T = rotated(yaw, pitch)
    T[:2, 3] = 0.8 * np.cos(yaw), 0.8 * np.sin(yaw)
    contact = Contact("pick", "object_00", np.array([0.0, 0.0, yaw]), T)
    assert np.isclose(contact.yaw, yaw)
    assert contact.is_straight
    assert not Contact("pick", "object_00", np.array([0.0, 0.1, yaw]), T).is_straight
    assert not Contact("pick", "object_00", np.array([0.0, 0.0, yaw + 0.3]), T).is_straight


def in_hand(scene: Scene) -> Scene:
    return grasped(scene, canonical_workspace(scene).grasps().for_object(scene, "object_00")[0])


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
    world, search = CollisionWorld.from_scene(scene), canonical_workspace(scene).placements()
    found = [
        list(itertools.islice(search.find(world, KeepClear(), STRATEGIES["lookahead"], np.random.default_rng(rng)), 3))
        for rng in (0, 1)
    ]
    for one, other in zip(*found, strict=True):
        assert np.array_equal(one.base, other.base)
        assert np.array_equal(one.q, other.q)
        assert abs(np.remainder(one.yaw - one.base[2] + np.pi, 2 * np.pi) - np.pi) < 1e-9
        assert np.linalg.norm(placement_cells(scene.support)[:, :2] - one.location, axis=1).min() < 1e-6


def test_where_no_cell_is_straight_the_placements_of_the_paper_follow(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = in_hand(random_scene(8, 1))
    world, search = CollisionWorld.from_scene(scene), canonical_workspace(scene).placements()
    monkeypatch.setattr(PlacementSearch, "_straight", lambda *_: iter(()))
    assert next(search.find(world, KeepClear(), STRATEGIES["lookahead"], np.random.default_rng(0)), None) is not None
