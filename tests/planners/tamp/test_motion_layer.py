"""Grasps that motions did not lead to, as the motion layer remembers them."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import patch

import numpy as np

from planners.context import PlanningContext
from planners.placing import placements
from planners.tamp import motion_layer
from planners.tamp.motion_layer import MotionLayer
from tests.planners.scenes import random_scene

SCENE = random_scene(6, 0)
CONTEXT = PlanningContext.of(SCENE.robot, SCENE, grasps="side")


def new_layer() -> MotionLayer:
    return MotionLayer(CONTEXT, np.random.default_rng(0))


def test_an_object_never_counts_as_in_the_way_of_its_own_grasp() -> None:
    layer, name, other = new_layer(), "object_00", "object_01"
    first, second = layer.candidates.for_object(SCENE, name)[:2]

    layer.obstruct(SCENE, first, frozenset({name, other}))
    changed = next(option for option in layer.candidates.for_object(SCENE, name) if option.key == first.key)
    assert changed.blockers == first.blockers | SCENE.mask([other])

    layer.obstruct(SCENE, second, frozenset({name}))
    assert second.key not in {option.key for option in layer.candidates.for_object(SCENE, name)}
    assert layer.has_refuted


def test_whether_the_gripper_can_leave_a_grasp_is_worked_out_once_for_each_place_of_the_object() -> None:
    first, second = new_layer().candidates.for_object(SCENE, "object_00")[:2]
    other, own = (SCENE.body(name) for name in ("object_01", "object_00"))
    elsewhere = SCENE.with_body(other.at(other.position + [0.0, 0.0, 0.001]))
    moved = SCENE.with_body(own.at(own.position + [0.0, 0.0, 0.001]))
    with patch.object(placements, "planned_approach", wraps=placements.planned_approach) as asked:
        layer = new_layer()
        answers = [layer.is_usable(scene, first) for scene in (SCENE, SCENE, elsewhere)]
        assert asked.call_count == 1
        assert answers == [new_layer().is_usable(elsewhere, first)] * 3
        asked.reset_mock()
        layer.is_usable(SCENE, second)
        layer.is_usable(moved, first)
        assert asked.call_count == 2


def test_a_grasp_whose_straight_lines_are_blocked_counts_as_refuted_by_motion() -> None:
    """As under a shelf, where they hit more than the grasp does: the lower bound knows nothing of it."""
    layer = new_layer()
    grasp = replace(layer.candidates.for_object(SCENE, "object_00")[0], drives=True)
    with patch.object(motion_layer, "fewest_blockers", return_value=SCENE.mask(["object_01"])):
        layer._reject(SCENE, grasp)
    assert layer.has_refuted
    assert layer.unusable == 1
