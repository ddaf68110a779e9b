"""Picks and places under a shelf: base waypoints, predicted arms, clearance, refusals."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from assets import FETCH
from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.policies.motion.network import ELSEWHERE, SHELF_PHASES, KeyframeNetwork, contact_in_base
from clutter_env.policies.motion.shelf import (
    ShelfArm,
    ShelfKeyframePlanner,
    base_waypoint,
    drive_points,
    table_of,
)
from clutter_env.policies.parsed_observation import ParsedObservation, parse_observation, planar_pose
from clutter_env.policies.weights import shipped_path
from clutter_env.scene.layout import find_layout
from clutter_env.task import Task
from clutter_env.training.motion_examples import Motion, cut_at_corners, free_joints_of, planned_motions

SHELF = Task("clutter_env/Retrieve-o10-v0", {"layout": "shelf", "obstructed": True})
LAYOUT = find_layout("shelf")
TABLE = table_of(LAYOUT)
_ROW = OBSERVATION_LAYOUT["objects"]


@pytest.fixture(scope="module")
def motions() -> list[Motion]:
    return list(planned_motions(SHELF.make(), "side", range(2)))


@pytest.fixture(scope="module")
def network() -> KeyframeNetwork:
    return KeyframeNetwork.load(shipped_path("motions", "shelf"))[0].eval()


@pytest.fixture(scope="module")
def seen() -> ParsedObservation:
    return parse_observation(SHELF.make().reset(seed=0)[0])


def with_object(seen: ParsedObservation, at: Any, half: Any) -> ParsedObservation:
    """The first object alone, and another one at a point in the world."""
    T = np.linalg.inv(planar_pose(seen.base))
    row = seen.objects[0].copy()
    row[_ROW["position"]], row[_ROW["half_extents"]] = T[:3, :3] @ at + T[:3, 3], half
    return dataclasses.replace(seen, objects=np.stack((seen.objects[0], row)))


def test_base_waypoints_are_those_of_demonstrations_and_drives_join_them(motions: list[Motion]) -> None:
    for motion in motions:
        cut = cut_at_corners(motion)
        for phase, steps in cut.runs():
            if phase in ELSEWHERE:
                keyframe = cut.keyframes[steps.stop - 1]
                np.testing.assert_allclose(base_waypoint(TABLE, motion.contact, phase), keyframe[:3], atol=1e-6)
        drive = drive_points(TABLE, motion.contact)
        np.testing.assert_allclose(drive[0], 0.0)
        outside = base_waypoint(TABLE, motion.contact, "leave")
        np.testing.assert_allclose(drive[-1, :2], outside[:2] - motion.contact.base[:2])
        assert np.linalg.norm(np.diff(drive, axis=0), axis=1).max() < 0.021


def test_correction_leads_the_predicted_gripper_to_where_it_is_wanted(
    motions: list[Motion], network: KeyframeNetwork
) -> None:
    arms, errors = ShelfArm(network, FETCH, LAYOUT), []
    for motion in motions:
        base_tcp, sizes = contact_in_base(motion.contact.tcp, motion.contact.base), motion.seen.sizes(motion.index)[0]
        free = free_joints_of(FETCH, cut_at_corners(motion))
        assert free is not None
        arguments = (motion.contact.skill, base_tcp, sizes, np.array([0.0, 0.03]), np.tile(free, (2, 1)))
        errors.append([arms.on_line(*arguments, rounds=rounds)[1].max() for rounds in (0, 6)])
    before, after = np.array(errors).T
    assert after.max() < 0.001 < before.max()


def test_the_chosen_arm_keeps_clear_of_what_stands_in_its_path(
    motions: list[Motion], network: KeyframeNetwork, seen: ParsedObservation
) -> None:
    contact = max(motions, key=lambda motion: float(motion.contact.tcp[0, 3])).contact
    arms = ShelfArm(network, FETCH, LAYOUT)
    free = arms.choose(contact, 0, dataclasses.replace(seen, objects=seen.objects[:1]))
    base_tcp = contact_in_base(contact.tcp, contact.base)
    q, _ = arms.on_line(contact.skill, base_tcp, seen.sizes(0), np.zeros(1), free.low[None], rounds=6)
    T = planar_pose(np.array(contact.base))
    elbow = T[:3, :3] @ arms.ball_centres(q)[0, 4] + T[:3, 3]
    other = arms.choose(contact, 0, with_object(seen, elbow, 0.01))
    assert not other.is_blocked
    assert np.abs(other.low - free.low).max() > 0.04 or other.is_flipped != free.is_flipped


def test_a_pick_that_something_is_in_the_way_of_is_refused_at_first(
    motions: list[Motion], network: KeyframeNetwork, seen: ParsedObservation
) -> None:
    contact = motions[0].contact
    blocked = with_object(seen, contact.tcp[:3, 3] - (0.15, 0.0, 0.0), (0.03, 0.03, 0.1))
    free = dataclasses.replace(seen, objects=seen.objects[:1])
    planner = ShelfKeyframePlanner(network, FETCH, LAYOUT)
    assert planner.begin(contact, 0, free) == list(SHELF_PHASES["pick"])
    assert [bool(planner.begin(contact, 0, blocked)) for _ in range(3)] == [False, False, True]
