"""Lines of sight against MuJoCo's rays, on random configurations and random points."""

import dataclasses

import mujoco
import numpy as np
import pytest

from assets.robots import FETCH
from clutter_env.experiments.maps.bases.visibility import CameraRays
from irm.arm.chain_arrays import chain_arrays
from irm.arm.kinematics import ArmChain, forward
from irm.errors import QueryError
from irm.visibility.robot_view import link_of_body, read_view
from irm.visibility.sight_kernel import seen_points

OPENING = 0.06


@pytest.fixture
def random_scenes():
    """Configurations with the gripper away from the body, and points around the gripper and before the robot.

    Closer to the body, a link of a random configuration may contain the camera and the point, and no ray finds it.
    """
    rng, chain = np.random.default_rng(3), ArmChain.from_robot(FETCH)
    scenes = []
    for q in rng.uniform(chain.lower, chain.upper, (1200, chain.size)):
        tcp = forward(chain, q)[:3, 3]
        if np.hypot(tcp[0], tcp[1]) < 0.7:
            continue
        near = tcp + rng.uniform(-0.15, 0.15, (6, 3))
        scenes.append((q, np.concatenate([near, rng.uniform((0.0, -0.6, 0.0), (1.2, 0.6, 1.5), (6, 3))])))
    return scenes


@pytest.mark.parametrize("camera", ["head", "gripper"])
def test_the_camera_sees_what_rays_of_mujoco_reach(random_scenes, camera):
    arm, view = chain_arrays(ArmChain.from_robot(FETCH)), read_view(FETCH, camera, OPENING)
    rays = CameraRays(FETCH, camera, OPENING)
    counts = np.zeros((2, 2), dtype=int)
    for q, points in random_scenes:
        seen = np.empty(len(points), dtype=bool)
        total = seen_points(arm, view, q, points, seen)
        assert total == seen.sum()
        for ours, theirs in zip(seen, rays.seen(q, points), strict=True):
            counts[int(ours), int(theirs)] += 1
    assert counts[0, 1] == counts[1, 0] == 0
    assert counts[0, 0] > 300
    assert counts[1, 1] > 300


def test_the_arm_hides_points_and_the_image_ends(random_scenes):
    """The agreement above would mean little if points were hidden by one of the two alone."""
    rays = CameraRays(FETCH, "head", OPENING)
    by_arm = outside = 0
    for q, points in random_scenes:
        in_image, hidden = rays.in_image(q, points), rays.are_hidden(q, points)
        by_arm, outside = by_arm + np.sum(in_image & hidden), outside + np.sum(~in_image & ~hidden)
    assert by_arm > 200
    assert outside > 200


def test_spheres_and_other_shapes_hide_too(tmp_path):
    """A sphere, and an ellipsoid, in place of the wrist: rays agree for the sphere, and hit less than the box of the
    ellipsoid."""
    chain, rng = ArmChain.from_robot(FETCH), np.random.default_rng(4)
    wrong = {"sphere": [0, 0], "ellipsoid": [0, 0]}
    for kind, counts in wrong.items():
        path = tmp_path / f"{kind}.xml"
        ball = f'<geom type="{kind}" size="0.15 0.1 0.05" pos="0.1 0.05 0"/><body name="gripper_link"'
        path.write_text(FETCH.mjcf_path.read_text().replace('<body name="gripper_link"', ball))
        robot = dataclasses.replace(FETCH, mjcf=str(path))
        view, rays = read_view(robot, "head", OPENING), CameraRays(robot, "head", OPENING)
        for q in rng.uniform(chain.lower, chain.upper, (150, chain.size)):
            points, seen = forward(chain, q)[:3, 3] + rng.uniform(-0.25, 0.25, (8, 3)), np.empty(8, dtype=bool)
            seen_points(chain_arrays(chain), view, q, points, seen)
            truth = rays.seen(q, points)
            counts[0] += np.sum(seen & ~truth)
            counts[1] += np.sum(~seen & truth)
    assert wrong["sphere"] == [0, 0]
    assert wrong["ellipsoid"][0] == 0
    assert wrong["ellipsoid"][1] > 0


def test_every_body_belongs_to_the_link_that_moves_it():
    model = mujoco.MjModel.from_xml_path(str(FETCH.mjcf_path))
    links = link_of_body(model, FETCH)
    expected = {"base_link": -1, "torso_lift_link": 0, "head_tilt_link": 0, "shoulder_pan_link": 1}
    expected |= {"wrist_roll_link": 7, "gripper_link": 7, "l_gripper_finger_link": 7}
    assert {name: links[model.body(name).id] for name in expected} == expected


def test_an_unknown_camera_is_an_error_that_lists_the_cameras():
    with pytest.raises(QueryError, match="head, gripper"):
        read_view(FETCH, "chest", OPENING)
