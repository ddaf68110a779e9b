"""Motions under a board: laws of where the base goes and of how the arm is chosen."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import assets  # noqa: E402
import clutter_env  # noqa: E402, F401  registers the environments
from assets.robots import FETCH  # noqa: E402
from clutter_env.envs.observation import OBSERVATION_LAYOUT  # noqa: E402
from clutter_env.policies.parsed_observation import Cylinders  # noqa: E402
from clutter_env.learning.contacts.reading import Reading, read  # noqa: E402
from clutter_env.policies.parsed_observation import planar_pose  # noqa: E402
from clutter_env.policies.motion.shelf_arm import ArmBalls  # noqa: E402
from clutter_env.learning.keyframes.boards.arm_line import ArmLine  # noqa: E402
from clutter_env.training.motion_examples import cut_at_corners  # noqa: E402
from clutter_env.policies.motion.shelf_arm import GripperPoints  # noqa: E402
from clutter_env.learning.keyframes.boards.guide import BoardGuide  # noqa: E402
from clutter_env.learning.keyframes.boards.postures import BoardPostures  # noqa: E402
from clutter_env.learning.keyframes.boards.stations import Stations, way_points  # noqa: E402
from clutter_env.policies.motion.shelf import table_of  # noqa: E402
from clutter_env.policies.motion.shelf_arm import Surroundings  # noqa: E402
from clutter_env.learning.keyframes.configurations import is_wrist_turned, with_wrist_turned  # noqa: E402
from clutter_env.learning.keyframes.examples import posture_of  # noqa: E402
from clutter_env.policies.motion.network_input import contact_in_base  # noqa: E402
from clutter_env.training.motion_demonstrations import Motion  # noqa: E402
from clutter_env.policies.motion.network import KeyframeNetwork  # noqa: E402
from clutter_env.learning.keyframes.phases import BOARD_PHASES  # noqa: E402
from clutter_env.policies.motion.network_input import ELSEWHERE  # noqa: E402
from clutter_env.training.motion_demonstrations import planned_motions  # noqa: E402
from clutter_env.learning.task import Task  # noqa: E402
from clutter_env.scene.layout import LAYOUTS  # noqa: E402
from planners.collision.robot_pose_kernel import make_scratch, place_robot  # noqa: E402
from planners.collision.world import CollisionWorld  # noqa: E402
from planners.scene import RobotState, Scene  # noqa: E402

SHELF = Task("clutter_env/Retrieve-o10-v0", {"layout": "shelf", "obstructed": True})
LAYOUT = LAYOUTS["shelf"]


@pytest.fixture(scope="module")
def motions() -> list[Motion]:
    return list(planned_motions(SHELF.make(), "side", range(2)))


@pytest.fixture(scope="module")
def network() -> KeyframeNetwork:
    return KeyframeNetwork.load(assets.path("policies/keyframes-shelf.npz")).eval()


@pytest.fixture(scope="module")
def reading() -> Reading:
    observation, _ = SHELF.make().reset(seed=0)
    return read(observation)


def test_the_base_stands_where_demonstrations_have_it(motions: list[Motion]) -> None:
    for motion in motions:
        stations = Stations(table_of(LAYOUT), motion.contact)
        for phase, steps in cut_at_corners(motion).runs():
            if phase in ELSEWHERE:
                keyframe = cut_at_corners(motion).keyframes[steps.stop - 1]
                np.testing.assert_allclose(stations.at_end(phase), keyframe[:3], atol=1e-6)


def test_a_way_out_leads_from_the_contact_to_the_station_outside(motions: list[Motion]) -> None:
    contact = motions[0].contact
    way = way_points(table_of(LAYOUT), contact)
    np.testing.assert_allclose(way[0], 0.0)
    outside = Stations(table_of(LAYOUT), contact).at_end("leave")
    np.testing.assert_allclose(way[-1], outside[:2] - contact.base[:2])
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).max() < 0.021


def test_foresight_leads_the_gripper_to_where_it_is_wanted(motions: list[Motion], network: KeyframeNetwork) -> None:
    line, errors = ArmLine(network, FETCH), []
    for motion in motions:
        base_tcp = contact_in_base(motion.contact.tcp, np.array(motion.contact.base))
        posture = posture_of(FETCH, cut_at_corners(motion))
        assert posture is not None
        sizes = motion.reading.sizes(motion.index)[0]
        args = (motion.contact.skill, base_tcp, sizes, np.array([0.0, 0.03]), np.tile(posture, (2, 1)))
        errors.append([line.at(*args, rounds=rounds)[1].max() for rounds in (0, 6)])
    before, after = np.array(errors).T
    assert after.max() < 0.001 < before.max()


def test_balls_lie_along_the_solids_of_the_arm() -> None:
    world = CollisionWorld.from_scene(Scene(FETCH, RobotState(np.zeros(3), np.array(FETCH.home), 0.0), (), ()))
    balls = ArmBalls(FETCH)
    attached = world.attached(None)
    scratch = make_scratch(world.robot, attached)
    q = np.array(FETCH.home) + 0.2
    place_robot(world.robot, attached, scratch, np.zeros(3), q, 0.0)
    centres = balls.centres(q[None])[0]
    for solid in range(world.robot.held_from, len(world.robot.core)):
        if world.robot.link[solid] > 0:
            away = np.linalg.norm(centres - scratch.solids.position[solid], axis=1)
            own = np.isclose(away, world.robot.half[solid].max(), atol=1e-5)
            assert own.sum() == 2
            np.testing.assert_allclose(centres[own].mean(axis=0), scratch.solids.position[solid], atol=1e-5)
            np.testing.assert_allclose(balls.radius[own], world.robot.radius[solid])


def test_fingers_of_the_gripper_move_apart() -> None:
    gripper = GripperPoints(FETCH)
    closed, opened = gripper.at(0.0), gripper.at(0.03)
    moved = opened - closed
    is_finger = np.abs(moved).max(axis=1) > 0
    np.testing.assert_allclose(np.abs(moved[is_finger]), np.broadcast_to((0.0, 0.03, 0.0), moved[is_finger].shape))
    assert (moved[is_finger][:, 1] * np.sign(closed[is_finger][:, 1].round(3)) >= 0).all()
    assert 0.0 < opened[is_finger][:, 0].max() < 0.05
    assert closed[~is_finger][:, 0].max() < 0.0


def box_and_object(core: float) -> Surroundings:
    """A box about the origin, and an object of radius 0.1 m two metres ahead of it."""
    found = Cylinders(np.array([[2.0, 0.0, 0.0]]), np.array([0.1]), height=np.array([0.2]), core=np.array([core]))
    return Surroundings(np.zeros((1, 3)), np.array([[0.5, 0.5, 0.1]]), found)


def test_only_what_is_inside_for_certain_is_contained() -> None:
    around = box_and_object(core=0.05)
    outside = np.array([[0.0, 0.0, 0.15], [2.07, 0.0, 0.0], [2.0, 0.0, 0.3]])
    assert not around.contain(outside)
    for inside in ([0.4, 0.0, 0.05], [2.04, 0.0, 0.1]):
        assert around.contain(np.array([*outside, inside]))


def test_distances_are_those_to_boxes_and_upright_cylinders() -> None:
    around = box_and_object(core=0.1)
    points = np.array([[0.0, 0.0, 0.05], [0.0, 0.8, 0.5], [2.0, 0.3, 0.0], [2.0, 0.0, 0.3]])
    np.testing.assert_allclose(around.distance(points), [0.0, 0.5, 0.2, 0.1])


def test_a_posture_keeps_clear_of_what_stands_in_its_way(
    motions: list[Motion], network: KeyframeNetwork, reading: Reading
) -> None:
    contact = max(motions, key=lambda motion: float(motion.contact.tcp[0, 3])).contact
    choice, alone = BoardPostures(network, FETCH, LAYOUT), reading.objects[:1]
    free = choice.choose(contact, 0, dataclasses.replace(reading, objects=alone))
    base_tcp = contact_in_base(contact.tcp, np.array(contact.base))
    line = ArmLine(network, FETCH)
    q, _ = line.at(contact.skill, base_tcp, reading.sizes(0), np.zeros(1), free.low[None], rounds=6)
    T = np.linalg.inv(planar_pose(reading.base)) @ planar_pose(np.array(contact.base))
    small = reading.objects[0].copy()
    elbow = ArmBalls(FETCH).centres(q)[0, 4]
    small[OBSERVATION_LAYOUT["objects"]["position"]] = T[:3, :3] @ elbow + T[:3, 3]
    small[OBSERVATION_LAYOUT["objects"]["half_extents"]] = 0.01
    crowded = dataclasses.replace(reading, objects=np.concatenate((alone, small[None])))
    other = choice.choose(contact, 0, crowded)
    assert not other.is_blocked
    assert np.abs(other.low - free.low).max() > 0.04 or other.is_turned != free.is_turned


def test_a_wrist_keeps_its_form_while_an_object_is_held(network: KeyframeNetwork, motions: list[Motion]) -> None:
    place = next(motion for motion in motions if motion.contact.skill == "place")
    held = Reading(*(getattr(place.reading, entry.name)[0] for entry in dataclasses.fields(Reading)))
    choice = BoardPostures(network, FETCH, LAYOUT)
    for q in (np.array(FETCH.home), with_wrist_turned(FETCH, np.array(FETCH.home))):
        posture = choice.choose(place.contact, 0, dataclasses.replace(held, q=q))
        assert posture.is_turned == is_wrist_turned(FETCH, q)


def test_a_contact_that_something_is_in_the_way_of_is_refused_at_first(
    motions: list[Motion], network: KeyframeNetwork, reading: Reading
) -> None:
    contact = motions[0].contact
    T = np.linalg.inv(planar_pose(reading.base))
    column = reading.objects[0].copy()
    before = contact.tcp[:3, 3] - (0.15, 0.0, 0.0)
    column[OBSERVATION_LAYOUT["objects"]["position"]] = T[:3, :3] @ before + T[:3, 3]
    column[OBSERVATION_LAYOUT["objects"]["half_extents"]] = (0.03, 0.03, 0.1)
    guide = BoardGuide(network, FETCH, LAYOUT)
    free, blocked = (
        dataclasses.replace(reading, objects=rows)
        for rows in (reading.objects[:1], np.concatenate((reading.objects[:1], column[None])))
    )
    assert guide.begin(contact, 0, free) == list(BOARD_PHASES["pick"])
    assert [bool(guide.begin(contact, 0, blocked)) for _ in range(3)] == [False, False, True]
