"""What the motion layer remembers of grasps that motions did not lead to."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np

from planners.collision.world import CompiledScenes
from planners.grasping.candidates import GraspCandidates
from planners.placing.placements import PlacementSearch
from planners.planner import map_placer
from planners.tamp import usable_grasps
from planners.tamp.motion_layer import MotionLayer
from planners.tamp.usable_grasps import UsableGrasps
from tests.planners.motion_scenes import CHAIN
from tests.planners.scenes import random_scene


def test_an_object_never_counts_as_in_the_way_of_its_own_grasp() -> None:
    scene = random_scene(6, 0)
    placer = map_placer(scene)
    motion_layer = MotionLayer(GraspCandidates(placer, CHAIN), PlacementSearch(placer, CHAIN), np.random.default_rng(0))
    name, other = "object_00", "object_01"
    first, second = motion_layer.candidates.for_object(scene, name)[:2]

    motion_layer.obstruct(scene, first, frozenset({name, other}))
    changed = next(option for option in motion_layer.candidates.for_object(scene, name) if option.key == first.key)
    assert changed.blockers == first.blockers | scene.mask([other])

    motion_layer.obstruct(scene, second, frozenset({name}))
    assert second.key not in {option.key for option in motion_layer.candidates.for_object(scene, name)}
    assert motion_layer.has_refuted


def test_whether_the_gripper_can_leave_a_grasp_is_worked_out_once_for_each_place_of_the_object() -> None:
    scene = random_scene(6, 0)
    candidates = GraspCandidates(map_placer(scene), CHAIN)
    first, second = candidates.for_object(scene, "object_00")[:2]
    other, own = (scene.body(name) for name in ("object_01", "object_00"))
    elsewhere = scene.with_body(other.at(other.position + [0.0, 0.0, 0.001]))
    moved = scene.with_body(own.at(own.position + [0.0, 0.0, 0.001]))
    with patch.object(usable_grasps, "can_leave", wraps=usable_grasps.can_leave) as asked:
        is_usable = UsableGrasps(CompiledScenes())
        answers = [is_usable(which, first) for which in (scene, scene, elsewhere)]
        assert asked.call_count == 1
        assert answers == [UsableGrasps(CompiledScenes())(elsewhere, first)] * 3
        asked.reset_mock()
        is_usable(scene, second)
        is_usable(moved, first)
        assert asked.call_count == 2
