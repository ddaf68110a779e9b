"""The end-to-end policy: its geometry, its network's laws, and its controller."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

from assets import FETCH
from clutter_env.policies.end_to_end.anchors import (
    DIRECTIONS,
    ObservedObjects,
    nearest_direction,
    observed_objects,
    table_cells,
)
from clutter_env.policies.end_to_end.controller import PHASES, Controller, Keyframe
from clutter_env.policies.end_to_end.differential_ik import DifferentialIK
from clutter_env.policies.end_to_end.network import EndToEndNetwork, Scenes, Tables
from clutter_env.policies.end_to_end.policy import KIND, EndToEndPolicy
from clutter_env.policies.parsed_observation import parse_observation
from clutter_env.policies.protocol import PolicyError, PublicInfo
from clutter_env.policies.registry import load_policy, policy_families, policy_files
from clutter_env.policies.weights import shipped_path
from clutter_env.scene.layout import find_layout
from clutter_env.training.grasp_labels import scene_of
from irm import ArmChain
from irm.kinematics import forward
from planners.placing.locations import placement_cells


@pytest.fixture(scope="module")
def network() -> EndToEndNetwork:
    """A network with random weights."""
    torch.manual_seed(0)
    return EndToEndNetwork(16).eval()


def random_scenes(count: int, target: int = 0) -> Scenes:
    rng = np.random.default_rng(count)
    rows = np.column_stack((rng.uniform(-0.3, 0.3, (count, 2)), np.full(count, 0.75), np.full((count, 2), (0.03, 0.2))))
    there = torch.ones(1, count, dtype=torch.bool)
    return Scenes(torch.tensor(rows[None], dtype=torch.float32), there, there, torch.arange(count)[None] == target)


def test_inverse_kinematics_come_to_poses_that_the_arm_reaches() -> None:
    ik, chain, rng = DifferentialIK(FETCH), ArmChain.from_robot(FETCH), np.random.default_rng(0)
    home = np.array(FETCH.in_front)
    for _ in range(10):
        goal = home + rng.uniform(-0.3, 0.3, 8) * (0.2, *np.ones(7))
        goal[4] -= 0.3  # off the elbow's limit
        T = forward(chain, goal)
        q = ik.solve(home, T, home, iterations=30)
        assert np.abs(forward(chain, q)[:3, 3] - T[:3, 3]).max() < 1e-3
        np.testing.assert_allclose(forward(chain, q)[:3, :3], T[:3, :3], atol=5e-3)


def test_directions_and_cells_are_those_of_canonical_plans(env: gym.Env[Any, Any]) -> None:
    env.reset(seed=0)
    np.testing.assert_allclose(table_cells(find_layout("paper")), placement_cells(scene_of(env).support)[:, :2])
    for number, yaws in enumerate(DIRECTIONS):
        found, off = nearest_direction(*yaws)
        assert (found, off < 1e-9) == (number, True)
        _, off = nearest_direction(*-yaws)  # every direction has its mirror image
        assert off < 1e-9


def test_objects_are_read_as_they_stand(env: gym.Env[Any, Any]) -> None:
    observation, info = env.reset(seed=3)
    found, scene = observed_objects(parse_observation(observation)), scene_of(env)
    for index, body in enumerate(scene.objects):
        expected = (*body.position[:2], body.bottom, body.radius, body.top - body.bottom)
        np.testing.assert_allclose(found.rows[index], expected, atol=1e-4)
    assert scene.names[found.target] == info["target"]
    assert found.held == -1
    assert found.can_be_taken[: len(scene.objects)].all()


def test_the_order_of_objects_and_absent_ones_change_no_choice(network: EndToEndNetwork) -> None:
    scenes, order = random_scenes(6), torch.tensor([3, 0, 5, 1, 4, 2])
    padded = Scenes(*(torch.cat((part, torch.zeros_like(part[:, :2])), dim=1) for part in scenes))
    with torch.no_grad():
        logits, needs = network.point(scenes, network.tables(scenes))
        shuffled = Scenes(*(part[:, order] for part in scenes))
        others, _ = network.point(shuffled, network.tables(shuffled))
        torch.testing.assert_close(others, logits[:, order])
        more, more_needs = network.point(padded, network.tables(padded))
        torch.testing.assert_close(more[:, :6], logits)
        held, cells, before = scenes.objects[:, 1], torch.tensor([[0.1, 0.0], [-0.2, 0.3]]), torch.zeros(1, 2)
        places = network.place_logits(scenes, network.judge_places(scenes, needs, held, cells), before)
        again = network.place_logits(padded, network.judge_places(padded, more_needs, held, cells), before)
        torch.testing.assert_close(places, again)
    assert (more[:, 6:] < logits.min()).all()


def test_what_the_target_needs_moved_is_found_along_the_tables(network: EndToEndNetwork) -> None:
    scenes, count = random_scenes(5), len(DIRECTIONS)
    blocks = torch.zeros(1, 5, count, 5)
    blocks[0, 0, :, 1] = blocks[0, 1, :, 2] = blocks[0, 4, :, 3] = 1.0  # 2 before 1 before the target 0; 3 before 4
    with torch.no_grad():
        found = network.needs(scenes, Tables(torch.full((1, 5, count), 5.0), blocks))
    need, cost = found.need[0], found.cost[0]
    torch.testing.assert_close(need, torch.tensor([1.0, 1.0, 1.0, 0.0, 0.0]))
    assert cost[0] > cost[1] > cost[2]
    assert cost[4] > cost[3]


def test_the_controller_goes_to_keyframes(env: gym.Env[Any, Any]) -> None:
    observation, _ = env.reset(seed=0)
    seen, controller = parse_observation(observation), Controller(FETCH)
    base = seen.base - (0.1, 0.0, 0.0)
    lifted = seen.tcp.copy()
    lifted[:3, 3] += (-0.1, 0.0, 0.05)
    home = np.array(FETCH.home)
    for phase, finger in (("drive", 0.0), ("ready", 0.03), ("lift", 0.0), ("retreat", 0.0)):
        controller.start(Keyframe(phase, base, lifted, home, finger), seen)
        while not controller.is_over:
            observation, *_ = env.step(controller.act(seen).astype(np.float32))
            seen = parse_observation(observation)
            controller.update(seen)
        assert not controller.has_stopped
        if phase == "lift":
            assert np.linalg.norm(seen.tcp[:3, 3] - lifted[:3, 3]) < 0.025
    assert np.abs(seen.base - base).max() < 0.01
    assert np.abs(seen.q - home).max() < 0.1
    assert seen.widths[0] == pytest.approx(FETCH.opening(0.03), abs=0.004)


def test_it_sees_observations_alone_and_gives_up_without_anything_to_take(network: EndToEndNetwork) -> None:
    env = gym.make("clutter_env/Retrieve-o5-v0")
    observation, info = env.reset(seed=0)
    policy = EndToEndPolicy(network, FETCH, find_layout("paper"))
    policy.reset(info)
    first = policy.act(observation)
    policy.reset(info)
    np.testing.assert_array_equal(policy.act(observation), first)
    assert policy.phase.split(": ")[1] in PHASES
    off = {name: values.copy() for name, values in observation.items()}
    off["objects"].reshape(5, -1)[:, 4] = -0.9  # all on the floor
    policy.reset(info)
    assert not policy.act(off)[:-1].any()
    assert policy.failure
    assert policy.done


def test_a_fallen_object_is_the_cylinder_around_it() -> None:
    env = gym.make("clutter_env/Retrieve-o1-v0")
    observation, _ = env.reset(seed=0)
    rows = observation["objects"].reshape(1, -1)
    before: ObservedObjects = observed_objects(parse_observation(observation))
    rows[0, 5:9] = (math.sqrt(0.5), math.sqrt(0.5), 0, 0)
    after = observed_objects(parse_observation(observation))
    assert not after.can_be_taken[0]
    radius, height = before.rows[0, 3:]
    np.testing.assert_allclose(after.rows[0, 3:], (height / 2, 2 * radius), rtol=1e-5)


def test_a_file_of_other_content_is_refused(tmp_path: Path) -> None:
    """A foreign key, a missing one and what is no number ended with a traceback, or played."""
    weights = dict(np.load(shipped_path(KIND, "side")))
    for name, changed in {
        "missing": {key: value for key, value in weights.items() if key != "anchor.bias"},
        "width": {**weights, "anchor.bias": weights["anchor.bias"][:-1]},
        "no number": {**weights, "anchor.bias": np.full_like(weights["anchor.bias"], np.nan)},
    }.items():
        np.savez(tmp_path / f"{name}.npz", **changed)
        with pytest.raises(PolicyError, match=rf"{name}.npz is damaged"):
            load_policy(f"end-to-end:{tmp_path / name}.npz", 0)
    with pytest.raises(PolicyError, match="names no file"):
        load_policy("end-to-end:", 0)


def test_weights_of_a_file_play_retrieve_alone_and_are_hashed(tmp_path: Path) -> None:
    file = tmp_path / "weights"
    shutil.copy(shipped_path(KIND, "side"), file)
    assert policy_families(f"end-to-end:{file}") == policy_families("end-to-end") == ("retrieve",)
    assert list(policy_files(f"end-to-end:{file}").values()) == list(policy_files("end-to-end").values())


@pytest.mark.parametrize(("env_id", "keywords"), [("Retrieve-o5-v0", {"control_mode": "ee"}), ("Skill-o5-v0", {})])
def test_other_actions_are_refused(env_id: str, keywords: dict[str, Any]) -> None:
    env = gym.make(f"clutter_env/{env_id}", **keywords)
    env.reset(seed=0)
    with pytest.raises(PolicyError, match="plays Retrieve with control_mode='joint'"):
        load_policy("end-to-end", 0).check(PublicInfo.of(env))
    env.close()
