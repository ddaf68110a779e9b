"""Plans from every grasp set: what they grasp with, how many they clear, and what lies or is low."""

from __future__ import annotations

import math

import numpy as np
import pytest

from assets.robots import FETCH
from planners import Planner, Scene, Solution
from planners.clearing.commitments import grasped
from planners.collision.world import CollisionWorld
from planners.contact import contact_of
from planners.grasping.candidates import GraspCandidates
from planners.grasping.families import GRASP_SETS, GraspFamily
from planners.motion.pick_and_place import PickPlaceMotion, plan_pick
from planners.scene import Body
from planners.tamp.solution import BoundAction
from planners.workspace import Workspace
from tests.planners.plans import assert_free
from tests.planners.scenes import HEIGHT, cylinder, random_scene, table_scene

PLANNERS = {name: Planner(FETCH, grasps=name) for name in GRASP_SETS}
SLANTED = tuple(one for one in GRASP_SETS["tilted"] + GRASP_SETS["top"] if isinstance(one, GraspFamily))
STEP = 0.002
"""[m] between the checks of a plan."""


def lying(name: str, x: float, y: float, radius: float = 0.03, heading: float = 0.4) -> Body:
    """A cylinder that has toppled: its axis is level."""
    c, s = math.cos(heading / 2), math.sin(heading / 2)
    down = math.sqrt(0.5)
    return cylinder(name, x, y, radius).at((x, y, HEIGHT + radius), (c * down, -s * down, c * down, s * down))


def pitch_of(action: BoundAction) -> float:
    """[rad] of the gripper where the fingers close or open."""
    contact = contact_of(action)
    assert contact is not None
    T = contact.tcp
    return math.atan2(-T[2, 0], T[2, 2])


@pytest.fixture(scope="module")
def obstructed() -> tuple[Scene, str]:
    """A scene and an object in it that no level gripper takes before something is cleared; every set reaches it."""
    scene = random_scene(25, 3)
    for name in scene.names:
        if PLANNERS["side"].clearance_floor(scene, name).count and all(
            PLANNERS[grasps].clearance_floor(scene, name).count is not None for grasps in ("tilted", "top")
        ):
            return scene, name
    raise AssertionError("no such object")


@pytest.mark.parametrize("grasps", GRASP_SETS)
def test_a_plan_grasps_and_releases_at_the_pitches_of_its_set(grasps: str, obstructed: tuple[Scene, str]) -> None:
    scene, target = obstructed
    found = PLANNERS[grasps].solve(scene, target)
    assert isinstance(found, Solution), found
    valid = [family.pitch for family in GRASP_SETS[grasps]]
    for action in found.actions:
        if action.name != "MoveBase":
            assert min(abs(pitch_of(action) - pitch) for pitch in valid) < 2e-3
    assert_free(found, STEP, 0.001)


@pytest.mark.slow
def test_more_grasps_never_need_more_clearances(obstructed: tuple[Scene, str]) -> None:
    scene, _ = obstructed
    for target in scene.names[:10]:
        floors = {name: PLANNERS[name].clearance_floor(scene, target) for name in GRASP_SETS}
        least = min(floor.count for floor in floors.values() if floor.count is not None)
        assert floors["all"].count is not None
        assert floors["all"].count <= least
        assert len(PLANNERS["all"].solve(scene, target).clearances) >= floors["all"].count


@pytest.mark.parametrize("height", [0.04, 0.05, 0.06])
@pytest.mark.parametrize("shape", ["cylinder", "box"])
def test_low_objects_are_taken(shape: str, height: float) -> None:
    half = np.array((0.03, 0.03, height / 2))
    body = Body("object_00", shape, half, np.array([0.0, 0.1, HEIGHT + height / 2]), np.array([1.0, 0.0, 0.0, 0.0]))
    found = PLANNERS["all"].solve(table_scene(body), "object_00")
    assert isinstance(found, Solution), found
    assert_free(found, STEP, 0.001)


@pytest.mark.parametrize("family", SLANTED, ids=lambda family: family.name)
@pytest.mark.parametrize("radius", [0.025, 0.035])
def test_a_toppled_cylinder_is_lifted_by_every_slanted_family(family: GraspFamily, radius: float) -> None:
    scene = table_scene(lying("object_00", -0.1, 0.0, radius))
    world = CollisionWorld.from_scene(scene)
    grasps = GraspCandidates(Workspace.of(scene.robot, scene).arms, families=(family,)).for_object(scene, "object_00")
    motions = [
        plan_pick(world, grasp.base, FETCH.home, grasp.q, "object_00", rng=np.random.default_rng(0))
        for grasp in grasps[:3]
    ]
    assert any(isinstance(motion, PickPlaceMotion) for motion in motions), motions


@pytest.mark.parametrize("family", SLANTED, ids=lambda family: family.name)
def test_a_toppled_obstacle_in_the_gripper_is_put_down_to_rest(family: GraspFamily) -> None:
    scene = table_scene(lying("object_00", -0.1, 0.0), cylinder("object_01", 0.1, -0.3))
    source = GraspCandidates(Workspace.of(scene.robot, scene).arms, families=(family,))
    in_hand = grasped(scene, source.for_object(scene, "object_00")[0])
    found = PLANNERS["all"].solve(in_hand, "object_01")
    assert isinstance(found, Solution), found
    assert [action.name for action in found.actions if action.name != "MoveBase"] == ["PutDownForClearance", "PickUp"]
    rests = found.actions[-1].scene.body("object_00")
    assert rests.bottom == pytest.approx(HEIGHT, abs=1.5e-3)
    level = np.abs(rests.rotation[2, 2])
    assert min(level, 1 - level) < 2e-3, "it stands, or its axis is level"
