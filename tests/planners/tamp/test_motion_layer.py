"""What the motion layer remembers of grasps that motions did not lead to."""

from __future__ import annotations

import numpy as np

from planners.grasping.candidates import GraspCandidates
from planners.placing.placements import PlacementSearch
from planners.planner import map_placer
from planners.tamp.motion_layer import MotionLayer
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
