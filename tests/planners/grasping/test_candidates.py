"""Grasp candidates, commitments and placements: laws on random scenes."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from assets.robots import FETCH
from irm.chain import ArmChain
from planners.clearing.lower_bound import self_clearable_sets
from planners.collision.world import CollisionWorld
from planners.grasping.candidates import GraspCandidate, GraspCandidates
from planners.grasping.families import GRASP_SETS, GraspFamily
from planners.grasping.scan_kernel import Few
from planners.motion.arm import tcp_pose
from planners.scene import SELF_BIT, STATIC_BIT, RobotState, Scene
from planners.workspace import Workspace
from tests.planners.scenes import cylinder, random_scene, table_scene

SOLID = 1 << STATIC_BIT | 1 << SELF_BIT
CHAIN = ArmChain.from_robot(FETCH)


def candidates(scene: Scene) -> GraspCandidates:
    return Workspace.of(scene.robot, scene, grasps="side").grasps()


@pytest.fixture(scope="module", params=[0, pytest.param(1, marks=pytest.mark.slow)])
def scene(request: pytest.FixtureRequest) -> Scene:
    return random_scene(25, request.param)


@pytest.fixture(scope="module")
def every(scene: Scene) -> dict[str, list[int]]:
    """The blocker masks of the grasps of all objects, each family looked at alone."""
    arms = Workspace.of(scene.robot, scene).arms
    sources = [
        GraspCandidates(arms, families=(family,)) for family in GRASP_SETS["all"] if isinstance(family, GraspFamily)
    ]
    return {
        name: [grasp.blockers for source in sources for grasp in source.for_object(scene, name)] for name in scene.names
    }


def some_candidates(scene: Scene) -> list[GraspCandidate]:
    source = candidates(scene)
    return [grasp for name in scene.names[:6] for grasp in source.for_object(scene, name)]


def test_candidates_put_the_gripper_around_the_object(scene: Scene) -> None:
    for option in some_candidates(scene):
        T = tcp_pose(FETCH, RobotState(option.base, option.q, 0.0))
        body = scene.body(option.object)
        assert np.allclose(T[:2, 3], body.position[:2], atol=1e-6)
        assert T[2, 3] - body.bottom == pytest.approx(FETCH.grasp_height, abs=1e-6)
        assert T[2, 2] == pytest.approx(1.0)
        assert np.allclose(T[:2, 0], [np.cos(option.yaw), np.sin(option.yaw)], atol=1e-6)


def test_blockers_are_what_the_collision_check_says(scene: Scene) -> None:
    world = CollisionWorld.from_scene(scene)
    for option in some_candidates(scene):
        own = scene.mask([option.object])
        hits = world.hits(option.base, option.q, option.opening, ignore=own)
        assert hits & SOLID == 0
        assert hits == option.blockers


def test_no_candidate_is_dominated_by_another(scene: Scene) -> None:
    source = candidates(scene)
    for name in scene.names[:6]:
        masks = {grasp.blockers for grasp in source.for_object(scene, name)}
        assert not any(one != other and one & ~other == 0 for one in masks for other in masks)


def test_families_are_looked_at_until_a_grasp_is_free(scene: Scene, every: dict[str, list[int]]) -> None:
    """What is not looked at cannot change the floor, and is looked at once the free grasps are removed."""
    for name in scene.names[:6]:
        masks = every[name]
        source = Workspace.of(scene.robot, scene).grasps()
        least = min((mask.bit_count() for mask in masks), default=None)
        assert least == min((grasp.blockers.bit_count() for grasp in source.for_object(scene, name)), default=None)
        ban_all_free(source, scene, name)
        assert {mask for mask in masks if mask} <= {grasp.blockers for grasp in source.for_object(scene, name)}


def ban_all_free(source: GraspCandidates, scene: Scene, name: str) -> list[GraspCandidate]:
    """Remove grasps with nothing in their way until there is none; those removed."""
    banned = []
    while free := [grasp for grasp in source.for_object(scene, name) if grasp.blockers == 0]:
        source.ban(scene, free[0])
        banned.append(free[0])
    return banned


def test_grasps_that_a_scan_left_out_are_offered_once_the_others_are_banned() -> None:
    """A scan keeps six grasps with nothing in their way; the object alone can be taken in many more."""
    scene = table_scene(cylinder("alone", -0.2, 0.1))
    banned = ban_all_free(candidates(scene), scene, "alone")
    assert len(banned) > 30
    assert len({grasp.pair for grasp in banned}) == len(banned)
    world, own = CollisionWorld.from_scene(scene), scene.mask(["alone"])
    assert not any(world.hits(grasp.base, grasp.q, grasp.opening, ignore=own) for grasp in banned)


def test_grasps_that_hit_more_are_offered_once_the_free_ones_are_banned() -> None:
    """A scan leaves out a grasp that hits more than another one does."""
    scene = table_scene(cylinder("wanted", -0.2, 0.0), cylinder("beside", -0.2, 0.12))
    source = candidates(scene)
    assert all(not grasp.blockers for grasp in source.for_object(scene, "wanted"))
    ban_all_free(source, scene, "wanted")
    assert {grasp.blockers for grasp in source.for_object(scene, "wanted")} == {scene.mask(["beside"])}


def test_an_obstructed_grasp_stays_as_it_is_when_others_are_looked_for(scene: Scene) -> None:
    name = next(
        name for name in scene.names if not min(grasp.blockers for grasp in candidates(scene).for_object(scene, name))
    )
    source, other = candidates(scene), scene.mask([next(other for other in scene.names if other != name)])
    first = source.for_object(scene, name)[0]
    source.obstruct(scene, first, other)
    banned = ban_all_free(source, scene, name)
    assert first.key not in {grasp.key for grasp in banned}
    assert [grasp.blockers for grasp in source.for_object(scene, name) if grasp.key == first.key] == [other]


def test_the_floor_of_the_lazy_candidates_is_that_of_all_families(scene: Scene, every: dict[str, list[int]]) -> None:
    lazy = Workspace.of(scene.robot, scene).grasps()
    for name in scene.names[:8]:
        found, exact = (
            next(self_clearable_sets(blockers, name, scene.names))
            for blockers in (partial(lazy.blockers, scene), every.__getitem__)
        )
        assert found.count == exact.count, name


def test_minimal_blockers_are_those_of_the_closer_look_and_hold_what_the_gripper_hits() -> None:
    scene = random_scene(25, 0)
    closer = Workspace.of(scene.robot, scene, grasps="side").looking_closely()
    for name in scene.names[:8]:
        every = set(closer.grasps().blockers(scene, name))
        minimal = {mask for mask in every if not any(other & ~mask == 0 for other in every - {mask})}
        source = closer.grasps()
        assert set(source.minimal_blockers(scene, name, Few(0, 64))) == minimal
        assert all(any(part & ~mask == 0 for part in source.hit_by_gripper(scene, name)) for mask in minimal)
        # With few objects, the object itself included, what has more of them may be left out.
        few = {mask for mask in source.minimal_blockers(scene, name, Few(0, 3)) if mask.bit_count() < 2}
        assert few == {mask for mask in minimal if mask.bit_count() < 2}


def test_an_object_off_the_table_has_no_grasps() -> None:
    scene = table_scene(cylinder("object_00", 0.0, 0.0), cylinder("object_01", -2.0, 0.0))
    fallen = scene.body("object_01").at((-2.0, 0.0, 0.08))
    scene = scene.with_body(fallen)
    assert candidates(scene).for_object(scene, "object_01") == ()
