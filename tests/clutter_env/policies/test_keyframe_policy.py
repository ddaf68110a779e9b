"""The keyframe policy: arm configurations, drives round the keep-out region, and picks from observations alone."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from assets import FETCH
from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.policies.motion.arm import ArmKinematics, shorter_turns, with_wrist_flipped
from clutter_env.policies.motion.keyframe_planner import RAISE, OpenKeyframePlanner
from clutter_env.policies.motion.keyframe_policy import KeyframePolicy
from clutter_env.policies.motion.network import KeyframeNetwork, KeyframePredictor, Q
from clutter_env.policies.parsed_observation import parse_observation, planar_pose
from clutter_env.policies.protocol import begin_episode
from clutter_env.policies.registry import load_policy
from clutter_env.policies.weights import PROBLEMS, shipped_path
from clutter_env.scene.keep_out import KeepOutRegion
from clutter_env.scene.layout import find_layout
from planners import Contact, tcp_pose
from planners.scene import RobotState
from scripts.shipped_weights.motion_examples import nearest_home
from scripts.shipped_weights.motions import keep_out_of_drives

Array = NDArray[np.float64]
_ROW = OBSERVATION_LAYOUT["objects"]


@pytest.fixture(scope="module")
def env() -> gym.Env[Any, Any]:
    return gym.make("clutter_env/Retrieve-o1-v0")


@pytest.fixture(scope="module")
def configurations() -> Array:
    rng = np.random.default_rng(0)
    limits = np.array([(max(link.lower, -6.0), min(link.upper, 6.0)) for link in FETCH.chain])
    return rng.uniform(limits[:, 0], limits[:, 1], (200, len(limits)))


def tcp_poses(configurations: Array) -> Array:
    return np.array([tcp_pose(FETCH, RobotState(np.zeros(3), q, 0.0)) for q in configurations])


def test_kinematics_in_torch_are_those_of_the_planner(configurations: Array) -> None:
    position, rotation = ArmKinematics(FETCH).tcp(torch.tensor(configurations, dtype=torch.float32))
    wanted = tcp_poses(configurations)
    np.testing.assert_allclose(position.numpy(), wanted[:, :3, 3], atol=1e-5)
    np.testing.assert_allclose(rotation.numpy(), wanted[:, :3, :3], atol=1e-5)


def test_configurations_near_home_and_with_the_wrist_flipped_have_the_same_gripper_pose(configurations: Array) -> None:
    home, flipped = nearest_home(FETCH, configurations), with_wrist_flipped(FETCH, configurations)
    for same in (home, flipped):
        np.testing.assert_allclose(tcp_poses(same), tcp_poses(configurations), atol=1e-9)
        assert np.abs(same - configurations).max() > 3
    np.testing.assert_allclose(nearest_home(FETCH, home), home)
    np.testing.assert_allclose(flipped[:, 6], -configurations[:, 6])


def test_joints_turn_at_most_half_a_turn_unless_a_limit_is_in_between(configurations: Array) -> None:
    home, endless = np.array(FETCH.home), [3, 5, 7]
    turned = shorter_turns(FETCH, home, configurations) - home
    assert np.abs(turned[:, endless]).max() <= np.pi + 1e-9
    np.testing.assert_allclose(np.cos(turned), np.cos(configurations - home), atol=1e-9)
    q = home.copy()
    q[5] = FETCH.chain[5].lower + 0.1
    for angle, expected in ((-3.0, -3.0), (-0.3, -0.3), (0.2, 0.2 - 2 * np.pi)):
        goal = home.copy()
        goal[5] = angle
        assert shorter_turns(FETCH, q, goal)[5] == pytest.approx(expected)


FRONT = KeepOutRegion(np.array((-0.65, -1.4)), np.array((np.inf, 1.4)))
"""Table and counters with a wall behind them."""
ISLAND = KeepOutRegion(np.array((-0.7, -0.9)), np.array((0.7, 0.9)))


def depth(region: KeepOutRegion, start: Array, path: Array) -> float:
    """[m] by which the straight lines of a path lie inside, measured at many points."""
    stops = np.vstack((start[:2], path[:, :2]))
    points = np.concatenate([np.linspace(one, other, 200) for one, other in pairwise(stops)])
    return float(np.minimum(points - region.low, region.high - points).min(axis=1).max())


@pytest.mark.parametrize(
    ("region", "start", "goal", "stops"),
    [
        (FRONT, (-1.2, 0.3, 0.0), (-0.66, 1.0, -0.8), 1),
        (FRONT, (-1.2, 0.3, 0.0), (0.2, 1.41, -1.57), 2),
        (FRONT, (0.2, -1.41, 1.57), (0.1, 1.41, -1.57), 3),
        (ISLAND, (-0.8, 0.3, 0.0), (0.8, 0.2, 3.1), 3),
        (ISLAND, (0.1, -0.95, 1.5), (0.8, 0.2, 3.1), 2),
    ],
)
def test_paths_are_straight_or_go_round_the_region(
    region: KeepOutRegion, start: tuple[float, ...], goal: tuple[float, ...], stops: int
) -> None:
    path = region.path(np.array(start), np.array(goal))
    assert len(path) == stops
    assert depth(region, np.array(start), path) < 1e-5
    np.testing.assert_allclose(path[-1], goal, atol=1e-9)


def test_the_region_is_what_demonstrations_drive_round() -> None:
    def drive(*stops: tuple[float, float]) -> Array:
        return np.concatenate([np.linspace(one, other, 40) for one, other in pairwise(stops)])

    front = [drive((-0.65, -0.5), (-0.65, 0.5)), drive((-0.7, 0.0), (-0.7, 1.4), (0.3, 1.4))]
    found = keep_out_of_drives([*front, drive((-0.8, 0.2), (-0.8, -1.4), (0.2, -1.4))])
    np.testing.assert_allclose((*found.low, found.high[1]), (-0.65, -1.4, 1.4), atol=0.021)
    assert found.high[0] == np.inf
    found = keep_out_of_drives([drive((-0.7, -0.9), (0.7, -0.9), (0.7, 0.9), (-0.7, 0.9), (-0.7, -0.9))])
    np.testing.assert_allclose((found.low, found.high), (ISLAND.low, ISLAND.high), atol=0.021)
    assert len(keep_out_of_drives([]).path(np.array((-1.0, 0.0, 0.0)), np.array((1.0, 0.0, 0.0)))) == 1


def driven(env: gym.Env[Any, Any], observation: Any, base: tuple[float, ...]) -> tuple[KeyframePolicy, Array]:
    """The policy of the package at the end of its drive to a contact ahead of a base, and where the base is then."""
    policy = KeyframePolicy.load(shipped_path("motions", "side"))
    ahead = np.eye(4)
    ahead[:3, 3] = 0.75, 0.0, 0.85
    policy.start(Contact("pick", "object_00", np.array(base), planar_pose(np.array(base)) @ ahead), observation)
    while not policy.is_done and policy.phase == "drive":
        observation, *_ = env.step(policy.act(observation))
    return policy, parse_observation(observation).base


@pytest.mark.parametrize("base", [(0.2, 1.41, -1.57), (0.2, -1.41, 1.57)])
def test_a_drive_to_the_side_of_a_counter_goes_round_its_corner(
    env: gym.Env[Any, Any], base: tuple[float, ...]
) -> None:
    observation, _ = env.reset(seed=4)
    policy, reached = driven(env, observation, base)
    assert not policy.has_failed
    np.testing.assert_allclose(reached[:2], base[:2], atol=0.03)


def test_a_pick_is_above_the_contact_and_moves_with_its_object_until_the_fingers_close(env: gym.Env[Any, Any]) -> None:
    observation, _ = env.reset(seed=0)
    policy = KeyframePolicy.load(shipped_path("motions", "side"))
    contact = Contact("pick", "object_00", np.array((-0.9, 0.0, 0.0)), planar_pose(np.array((-0.1, 0.0, 0.0))))
    policy.start(contact, observation)
    moved = {name: value.copy() for name, value in observation.items()}
    moved["objects"][2] += 0.01
    policy.act(moved)
    shift = parse_observation(moved).position(0) - parse_observation(observation).position(0)
    higher = shift + (0.0, 0.0, RAISE)
    np.testing.assert_allclose(policy.contact.tcp[:3, 3] - contact.tcp[:3, 3], higher, atol=1e-9)
    np.testing.assert_allclose(policy.contact.base[:2] - contact.base[:2], shift[:2], atol=1e-9)


def test_of_two_arm_configurations_the_one_that_is_clear_of_an_object_is_chosen(env: gym.Env[Any, Any]) -> None:
    seen = parse_observation(env.reset(seed=0)[0])
    network, _ = KeyframeNetwork.load(shipped_path("motions", "side"))
    kinematics, base = ArmKinematics(FETCH), np.array((-0.9, 0.1, 0.0))
    ahead = np.eye(4)
    ahead[:3, 3] = 0.78, 0.0, 0.85
    contact = Contact("pick", "object_00", base, planar_pose(base) @ ahead)
    planner = OpenKeyframePlanner(network, FETCH, find_layout("paper"))
    np.testing.assert_allclose(planner.free_joints(contact, 0, seen), 0.0)
    # A small object in the elbow of that configuration before the descent, higher than the wrist ever is.
    q = KeyframePredictor(network).predict("pick", "approach", ahead[None], seen.sizes(0), 0.18, np.zeros(2))[:, Q]
    elbow = kinematics.links(torch.tensor(q, dtype=torch.float32))[0][0, 4].numpy().astype(float)
    T = np.linalg.inv(planar_pose(seen.base)) @ planar_pose(base)
    small = seen.objects[0].copy()
    small[_ROW["position"]] = T[:3, :3] @ elbow + T[:3, 3]
    small[_ROW["half_extents"]] = 0.01
    crowded = dataclasses.replace(seen, objects=np.stack((seen.objects[0], small)))
    assert np.abs(planner.free_joints(contact, 0, crowded)).max() > 0.04


@pytest.mark.parametrize("problem", PROBLEMS)
def test_boxes_which_no_weights_were_trained_with_are_taken_as_cylinders_are(problem: str) -> None:
    """The weights of the input that says what is a box were random: of 8 scenes of boxes none was clean."""
    network, ahead = KeyframeNetwork.load(shipped_path("motions", problem))[0], np.eye(4)[None]
    ahead[0, :3, 3] = 0.78, 0.0, 0.85
    one, other = (
        KeyframePredictor(network).predict(
            "pick", "lift", ahead, np.array((0.025, 0.025, 0.08, is_box)), 0.1, np.zeros(2)
        )
        for is_box in (0.0, 1.0)
    )
    np.testing.assert_array_equal(one, other)


def test_a_pick_whose_open_gripper_would_touch_the_wall_is_refused(env: gym.Env[Any, Any]) -> None:
    observation, _ = env.reset(seed=0)
    layout, phases = find_layout("paper"), []
    for before_wall in (0.02, 0.10):
        policy = KeyframePolicy.load(shipped_path("motions", "side"))
        tcp = planar_pose(np.array((layout.depth / 2 - before_wall, 0.0, 0.0)))
        tcp[2, 3] = 0.85
        policy.start(Contact("pick", "object_00", np.array((-0.65, 0.0, 0.0)), tcp), observation)
        phases.append(policy.phase)
        assert policy.has_failed == (not policy.phase)
    assert phases == ["", "drive"]


def test_a_level_gripper_takes_objects_higher_than_planned_but_below_their_top(env: gym.Env[Any, Any]) -> None:
    """The wrist is 9 mm above the table where plans take objects, and pressed on its edge."""
    seen = parse_observation(env.reset(seed=0)[0])
    network, _ = KeyframeNetwork.load(shipped_path("motions", "side"))
    planner = OpenKeyframePlanner(network, FETCH, find_layout("paper"))
    level = planar_pose(np.zeros(3))
    top = seen.position(0)[2] + seen.sizes(0)[2]
    raised = []
    for below in (0.10, 0.04, 0.02):
        level[2, 3] = top - below
        raised.append(planner.raise_pick(Contact("pick", "object_00", np.zeros(3), level), 0, seen))
    np.testing.assert_allclose(raised, (RAISE, 0.01, 0.0), atol=1e-6)


def test_an_arm_that_would_lie_on_furniture_is_not_chosen(env: gym.Env[Any, Any]) -> None:
    seen = parse_observation(env.reset(seed=0)[0])
    network, _ = KeyframeNetwork.load(shipped_path("motions", "side"))
    kinematics, base, ahead = ArmKinematics(FETCH), np.array((-0.9, 0.1, 0.0)), np.eye(4)
    ahead[:3, 3] = 0.78, 0.0, 0.85
    contact = Contact("pick", "object_00", base, planar_pose(base) @ ahead)
    planner = OpenKeyframePlanner(network, FETCH, find_layout("paper"))
    np.testing.assert_allclose(planner.free_joints(contact, 0, seen), 0.0)
    q = KeyframePredictor(network).predict("pick", "approach", ahead[None], seen.sizes(0), 0.0, np.zeros(2))[:, Q]
    elbow = planar_pose(base) @ np.append(
        kinematics.links(torch.tensor(q, dtype=torch.float32))[0][0, 4].numpy().astype(float), 1.0
    )
    planner._furniture = np.array([(elbow[:3] - (0.0, 0.0, 0.08), (0.02, 0.02, 0.02))])
    assert np.abs(planner.free_joints(contact, 0, seen)).max() > 0.04


def test_the_policy_of_the_package_takes_a_target_from_observations_alone(env: gym.Env[Any, Any]) -> None:
    policy: Any = load_policy("keyframes", seed=0)
    observation, info = env.reset(seed=1_000_003)
    begin_episode(policy, info, env)
    steps = 0
    while not info["lifted"] and steps < 300:
        observation, _, _, _, info = env.step(policy.act(observation))
        steps += 1
    assert info["is_success"]
