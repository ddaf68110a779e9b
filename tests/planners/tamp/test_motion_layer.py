"""Grasps that motions did not lead to, as the motion layer remembers them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from assets.robots import FETCH
from planners import find_strategy
from planners.cause import Cause
from planners.clearing import moves
from planners.clearing.moves import MoveMaker
from planners.goals import holding
from planners.motion.arm import tcp_pose
from planners.motion.path import NoPath
from planners.placing import placements
from planners.problem import Problem
from planners.strategies import STRATEGIES
from planners.tamp.motion_layer import MotionLayer
from planners.tamp.solution import ReplanRecord
from planners.tamp.state import Search
from planners.workspace import Workspace
from tests.planners.motion_scenes import arm_path
from tests.planners.scenes import cylinder, random_scene

SCENE = random_scene(6, 0)
POST = tuple(tcp_pose(FETCH, SCENE.state)[:2, 3] + [0.0385 - 0.015 + 0.03, -0.008])
"""x, y [m] of a post of 3 cm radius that the closed gripper just touches at home."""
WORKSPACE = Workspace.of(SCENE.robot, SCENE, grasps="side")


def new_layer() -> MotionLayer:
    return MotionLayer(WORKSPACE, np.random.default_rng(0))


def new_maker(layer: MotionLayer) -> MoveMaker:
    return layer.maker(STRATEGIES["lookahead"], holding("object_00"), SCENE)


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
        maker = new_maker(new_layer())
        answers = [maker.is_usable(scene, first) for scene in (SCENE, SCENE, elsewhere)]
        assert asked.call_count == 1
        assert answers == [new_maker(new_layer()).is_usable(elsewhere, first)] * 3
        asked.reset_mock()
        maker.is_usable(SCENE, second)
        maker.is_usable(moved, first)
        assert asked.call_count == 2


def test_a_grasp_whose_straight_lines_are_blocked_counts_as_refuted_by_motion() -> None:
    """As under a shelf, where they hit more than the grasp does: the lower bound knows nothing of it."""
    layer = new_layer()
    grasp = replace(layer.candidates.for_object(SCENE, "object_00")[0], drives=True)
    with patch.object(moves, "fewest_blockers", return_value=SCENE.mask(["object_01"])):
        new_maker(layer).reject(SCENE, grasp)
    assert layer.has_refuted
    assert layer.candidates.unusable == 1


def test_a_refusal_by_penetration_names_bodies_and_depth(tmp_path: Path) -> None:
    """A wheel 5.3 mm in the ground refuted every motion, and the cause was "motion", without a name.

    MuJoCo looks where the gripper is near something, here a post.
    """
    text, body = FETCH.mjcf_path.read_text(), '<body name="base_link" childclass="fetch" gravcomp="1">'
    wheel = '<body name="r_wheel_link" gravcomp="1"><geom type="sphere" size="0.05" pos="0 0 0.0447" mass="1"/></body>'
    assert body in text
    (tmp_path / "fetch.xml").write_text(text.replace(body, body + wheel))
    sunk, layer = replace(FETCH, mjcf=str(tmp_path / "fetch.xml")), new_layer()
    scene = replace(SCENE, robot=sunk, objects=(cylinder("post", *POST, 0.03, 0.4),))
    still = arm_path(scene.state.base, np.array(FETCH.home)[None], 0.0)
    assert layer.refusal(scene, [still]) in (
        "r_wheel_link and floor overlap by 5.3 mm",
        "floor and r_wheel_link overlap by 5.3 mm",
    )
    grasp = layer.candidates.for_object(SCENE, "object_00")[0]
    at_grasp = SCENE.with_state(replace(SCENE.state, base=grasp.base))
    with patch.object(MotionLayer, "refusal", return_value="r_wheel_link and floor overlap by 5.3 mm"):
        refused = layer.pick_up(at_grasp, grasp)
    assert refused == NoPath("MuJoCo finds penetration: r_wheel_link and floor overlap by 5.3 mm")


def test_refusals_that_differ_in_depth_alone_are_counted_together() -> None:
    strategy = find_strategy("lookahead")
    layer = new_layer()
    problem = Problem.of(SCENE, holding("object_00"), layer.workspace)
    search = Search(problem, strategy, None, layer)  # type: ignore[arg-type]  # it plans nothing
    reasons = ["c and d overlap by 3 mm", "a and b overlap by 1.0 mm", "a and b overlap by 12.5 mm"]
    search.history += [ReplanRecord((), 0, "", (), reason) for reason in reasons]
    assert "2 of 3 refutations: a and b overlap by 1.0 mm" in search.infeasible(Cause.MOTION, "none", ()).detail


def test_an_attempt_knows_for_which_places_the_one_before_found_no_motion() -> None:
    before, layer = new_layer(), new_layer()
    before.not_placed = before.not_placed.having("object_00", frozenset({"object_01"}), 0.5)
    problem = Problem.of(SCENE, holding("object_00"), layer.workspace)
    search = Search(problem, find_strategy("lookahead"), None, layer.with_known(before))  # type: ignore[arg-type]  # unused
    assert search.not_placed.blockers == {"object_00": frozenset({"object_01"})}
    assert search.not_placed.pitches == {"object_00": frozenset({0.5})}
    search.not_placed = search.not_placed.without_blocker("object_01")
    assert before.not_placed.blockers, "what moves in one attempt stands again in the next"
