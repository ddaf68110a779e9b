"""Motions of plans that are not simulated, their examples, and the network that is fitted to them.

Under a shelf also how the planner of keyframes executes such motions.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from assets import FETCH
from clutter_env.data.dataset import Dataset, Job
from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.errors import DatasetError
from clutter_env.policies.motion.arm import ArmKinematics
from clutter_env.policies.motion.network import (
    DRIVEN,
    ELSEWHERE,
    PHASES,
    POSE,
    SHELF_PHASES,
    KeyframeNetwork,
    contact_in_base,
)
from clutter_env.policies.motion.shelf import ShelfArm, ShelfKeyframePlanner, base_waypoint, drive_points, table_of
from clutter_env.policies.parsed_observation import ParsedObservation, parse_observation, planar_pose
from clutter_env.policies.weights import shipped_path
from clutter_env.scene.layout import find_layout
from clutter_env.task import Task
from planners import drive_out, tcp_pose
from planners.scene import RobotState
from scripts.shipped_weights.motion_examples import (
    Motion,
    cut_at_corners,
    free_joints_of,
    is_driven,
    keyframe_examples,
    planned_motions,
)
from scripts.shipped_weights.motions import fit_motions, high_level_of

OPEN = Task("clutter_env/Retrieve-o5-v0", {"obstructed": True})
SHELF = Task("clutter_env/Retrieve-o10-v0", {"layout": "shelf", "obstructed": True})
LAYOUT = find_layout("shelf")
TABLE = table_of(LAYOUT)
_ROW = OBSERVATION_LAYOUT["objects"]


@pytest.fixture(scope="module")
def in_the_open() -> list[Motion]:
    return list(planned_motions(OPEN.make(), "all", range(3)))


@pytest.fixture(scope="module")
def under_a_shelf() -> list[Motion]:
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
    return replace(seen, objects=np.stack((seen.objects[0], row)))


def gripper_at(keyframe: np.ndarray) -> np.ndarray:
    return tcp_pose(FETCH, RobotState(keyframe[:3], keyframe[3:11], 0.0))


def ends(motion: Motion) -> dict[str, np.ndarray]:
    """The keyframe of each phase."""
    return {phase: motion.keyframes[steps.stop - 1] for phase, steps in motion.runs()}


def test_a_planned_motion_shows_what_a_demonstration_shows(in_the_open: list[Motion]) -> None:
    for motion in in_the_open:
        assert not is_driven(motion)
        assert set(ends(motion)) - {"home"} <= set(PHASES[motion.contact.skill])
        last = ends(motion)["approach" if motion.contact.skill == "pick" else "lower"]
        np.testing.assert_allclose(gripper_at(last), motion.contact.tcp, atol=1e-6)
        np.testing.assert_allclose(motion.seen.tcp[-1], gripper_at(motion.keyframes[-1]), atol=1e-5)
        assert len(motion.seen.base) == len(motion.phases) + 1
    pitches = {round(float(np.degrees(np.arcsin(-motion.contact.tcp[2, 0])))) for motion in in_the_open}
    assert {0, 60} <= pitches, "all grasps are shown level and tilted"


def test_under_a_shelf_the_arm_is_rigid_on_the_drives_between_corners(under_a_shelf: list[Motion]) -> None:
    assert {motion.contact.skill for motion in under_a_shelf} == {"pick", "place"}
    for motion in under_a_shelf:
        assert is_driven(motion)
        cut, names = cut_at_corners(motion), SHELF_PHASES[motion.contact.skill]
        found = ends(cut)
        assert [name for name in found if name in names] == [name for name in names if name in found]
        assert set(DRIVEN) <= set(found)
        for one, other in (("transit", "enter"), ("enter", "reach"), ("back", "leave")):
            np.testing.assert_allclose(found[one][3:11], found[other][3:11], atol=1e-9)
        np.testing.assert_allclose(found["reach"][:2], motion.contact.base[:2], atol=1e-6)
        np.testing.assert_allclose(gripper_at(found["reach"])[:2, 3], motion.contact.tcp[:2, 3], atol=1e-6)
        along = found["reach"][:2] - found["enter"][:2]
        np.testing.assert_allclose(along, 0.1 * motion.contact.tcp[:2, 0], atol=1e-6)
        for phase, steps in cut.runs():
            if phase in DRIVEN:
                q = motion.seen.q[steps]
                np.testing.assert_allclose(q, np.broadcast_to(q[0], q.shape), atol=1e-6)


def test_base_waypoints_are_those_of_demonstrations_and_drives_join_them(under_a_shelf: list[Motion]) -> None:
    for motion in under_a_shelf:
        cut, poses = cut_at_corners(motion), drive_out(TABLE, motion.contact.base, motion.contact.tcp)
        for phase, steps in cut.runs():
            if phase in ELSEWHERE:
                keyframe = cut.keyframes[steps.stop - 1]
                np.testing.assert_allclose(base_waypoint(poses, phase), keyframe[:3], atol=1e-6)
        drive = drive_points(TABLE, motion.contact)
        np.testing.assert_allclose(drive[0], 0.0)
        outside = base_waypoint(poses, "leave")
        np.testing.assert_allclose(drive[-1, :2], outside[:2] - motion.contact.base[:2])
        assert np.linalg.norm(np.diff(drive, axis=0), axis=1).max() < 0.021


def test_correction_leads_the_predicted_gripper_to_where_it_is_wanted(
    under_a_shelf: list[Motion], network: KeyframeNetwork
) -> None:
    arms, errors = ShelfArm(network, FETCH, LAYOUT), []
    for motion in under_a_shelf:
        base_tcp, sizes = contact_in_base(motion.contact.tcp, motion.contact.base), motion.seen.sizes(motion.index)[0]
        free = free_joints_of(FETCH, cut_at_corners(motion))
        assert free is not None
        arguments = (motion.contact.skill, base_tcp, sizes, np.array([0.0, 0.03]), np.tile(free, (2, 1)))
        errors.append([arms.on_line(*arguments, rounds=rounds)[1].max() for rounds in (0, 6)])
    before, after = np.array(errors).T
    assert after.max() < 0.001 < before.max()


def test_the_chosen_arm_keeps_clear_of_what_stands_in_its_path(
    under_a_shelf: list[Motion], network: KeyframeNetwork, seen: ParsedObservation
) -> None:
    contact = max(under_a_shelf, key=lambda motion: float(motion.contact.tcp[0, 3])).contact
    arms = ShelfArm(network, FETCH, LAYOUT)
    free = arms.choose(contact, 0, replace(seen, objects=seen.objects[:1]))
    base_tcp = contact_in_base(contact.tcp, contact.base)
    q, _ = arms.on_line(contact.skill, base_tcp, seen.sizes(0), np.zeros(1), free.low[None], rounds=6)
    T = planar_pose(np.array(contact.base))
    elbow = T[:3, :3] @ arms.ball_centres(q)[0, 4] + T[:3, 3]
    other = arms.choose(contact, 0, with_object(seen, elbow, 0.01))
    assert not other.is_blocked
    assert np.abs(other.low - free.low).max() > 0.04 or other.is_flipped != free.is_flipped


def test_a_pick_that_something_is_in_the_way_of_is_refused_at_first(
    under_a_shelf: list[Motion], network: KeyframeNetwork, seen: ParsedObservation
) -> None:
    contact = under_a_shelf[0].contact
    blocked = with_object(seen, contact.tcp[:3, 3] - (0.15, 0.0, 0.0), (0.03, 0.03, 0.1))
    free = replace(seen, objects=seen.objects[:1])
    planner = ShelfKeyframePlanner(network, FETCH, LAYOUT)
    assert planner.begin(contact, 0, free) == list(SHELF_PHASES["pick"])
    assert [bool(planner.begin(contact, 0, blocked)) for _ in range(3)] == [False, False, True]


@pytest.mark.slow
def test_a_fitted_network_brings_the_gripper_where_demonstrations_do(in_the_open: list[Motion]) -> None:
    examples = keyframe_examples(FETCH, in_the_open)
    network = fit_motions(FETCH, in_the_open, steps=600)
    with torch.no_grad():
        predicted = network(torch.tensor(examples.features, dtype=torch.float32))
    position, _ = ArmKinematics(FETCH).tcp(predicted.q)
    wanted, _ = ArmKinematics(FETCH).tcp(torch.tensor(examples.q, dtype=torch.float32))
    error = torch.linalg.norm(position - wanted, dim=1).numpy()[examples.at_contact]
    assert np.median(error) < 0.02
    limits = np.array([(link.lower, link.upper) for link in FETCH.chain])
    assert (predicted.q.numpy() >= limits[:, 0] - 1e-5).all()
    assert (predicted.q.numpy() <= limits[:, 1] + 1e-5).all()


def test_a_network_knows_what_it_was_fitted_to(in_the_open: list[Motion], under_a_shelf: list[Motion]) -> None:
    for motions, is_under_shelf in ((in_the_open, False), (under_a_shelf, True)):
        network = fit_motions(FETCH, motions, steps=2)
        assert network.is_under_shelf == is_under_shelf
        assert network.has_seen("pick", "lift")
        assert network.has_seen("pick", "approach") != is_under_shelf
        assert (network.keep_out.low < network.keep_out.high).all()
        assert not network.layers[0].weight[:, POSE.stop + 3].any()  # boxes, which no plan shows
        if is_under_shelf:
            assert len(network.shown) == len(motions)
    with pytest.raises(DatasetError, match="canonical"):
        fit_motions(FETCH, [], steps=2)


def test_demonstrations_of_a_script_are_refused(tmp_path: Path) -> None:
    task = Task("clutter_env/Retrieve-o1-v0", {"control_mode": "ee"})
    scripted = Dataset.open_for(Job(task, "scripted", episodes=1), tmp_path / "scripted")
    with pytest.raises(DatasetError, match="canonical"):
        high_level_of(scripted)
