"""The reality dial: what each effect does, that it is seeded, and that nothing changes at 0; a base that must turn."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from clutter_env.config import EFFECTS
from clutter_env.envs.reality import LEVELS
from clutter_env.errors import ConfigError, StateError
from clutter_env.provenance import environment_digest
from planners import TampExpert

ID = "clutter_env/Retrieve-o5-v0"
STEPS = 12


def played(seed: int = 3, **keywords: Any) -> tuple[list[dict[str, np.ndarray]], list[np.ndarray], Any]:
    """Observations and true positions of an episode of random actions, and its environment."""
    env = gym.make(ID, **keywords).unwrapped
    observations, states = [env.reset(seed=seed)[0]], [env.data.qpos.copy()]
    for action in np.random.default_rng(0).uniform(-1, 1, (STEPS, env.action_size)):
        observations.append(env.step(action)[0])
        states.append(env.data.qpos.copy())
    return observations, states, env


@pytest.fixture(scope="module")
def exact() -> tuple[list[dict[str, np.ndarray]], list[np.ndarray], Any]:
    """The episode as it is without any effect."""
    return played()


def equal(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> list[str]:
    """Entries in which two observations are the same."""
    return [name for name in one if np.allclose(one[name], other[name], atol=1e-6)]


def test_nothing_changes_at_zero(exact: Any) -> None:
    observations, _, env = played(reality=0)
    assert all(
        np.array_equal(one[name], other[name])
        for one, other in zip(exact[0], observations, strict=True)
        for name in one
    )
    assert env.perceived is env.world
    assert environment_digest(env) == environment_digest(exact[2])


def test_episodes_are_seeded_and_begin_in_the_same_scene(exact: Any) -> None:
    first, states, env = played(reality=0.8)
    second, again, _ = played(reality=0.8)
    assert all(np.array_equal(one[n], other[n]) for one, other in zip(first, second, strict=True) for n in one)
    assert np.array_equal(states, again)
    assert not np.array_equal(first[0]["objects"], played(4, reality=0.8)[0][0]["objects"])
    scene, plain = env.world.scene, exact[2].world.scene
    np.testing.assert_array_equal(scene.positions, plain.positions)
    assert 0 < np.abs(scene.half_extents / plain.half_extents - 1).max() <= 0.8 * LEVELS.size
    assert 0 < np.abs(scene.masses / plain.masses - 1).max() <= 0.8 * LEVELS.mass
    np.testing.assert_array_equal(env.perceived.scene.half_extents, plain.half_extents)
    assert environment_digest(env)["settings"]["reality"] == 0.8
    assert "reality" in environment_digest(env)


def test_a_late_observation_is_an_earlier_one(exact: Any) -> None:
    late = played(reality={"observation_delay": 1.0})[0]
    steps = int(LEVELS.observation_delay)
    for step in range(steps, STEPS + 1):
        assert len(equal(late[step], {**exact[0][step - steps], "goal": late[step]["goal"]})) == len(late[step])


def test_a_late_action_is_carried_out_later(exact: Any) -> None:
    late = played(reality={"action_delay": 1.0})[1]
    steps = int(LEVELS.action_delay)
    still = np.allclose(late[steps], late[0], atol=1e-3)
    assert still, "before the first action arrives nothing moves"
    assert not np.allclose(late[-1], exact[1][-1], atol=1e-3)


@pytest.mark.parametrize(
    ("effect", "changed"),
    [("poses", {"objects", "goal"}), ("joints", {"robot", "tcp", "goal"}), ("camera", {"objects", "goal"})],
)
def test_an_effect_alone_changes_what_it_names(exact: Any, effect: str, changed: set[str]) -> None:
    seen, states, env = played(reality={effect: 1.0})
    np.testing.assert_array_equal(states[-1], exact[1][-1])
    assert set(seen[0]) - set(equal(seen[0], exact[0][0])) <= changed
    rows = [observations[0]["objects"].reshape(-1, 14)[:, 2:5] for observations in (seen, exact[0])]
    assert (np.abs(rows[0] - rows[1]).max() > 0) == ("objects" in changed)
    assert np.abs(rows[0] - rows[1]).max() < 0.06
    assert np.abs(rows[0] - rows[1])[:, 2].max() < 1e-5, "heights are the support's"
    again = played(reality={effect: 1.0})[2]
    np.testing.assert_array_equal(env.perceived.data.qpos, again.perceived.data.qpos)


def test_errors_of_the_model_do_not_add_up_over_episodes() -> None:
    env = gym.make(ID, reality=1.0).unwrapped
    plain = gym.make(ID).unwrapped.model
    for seed in range(4):
        env.reset(seed=seed)
        ratio = env.model.geom_friction[:, 0] / plain.geom_friction[:, 0]
        assert np.abs(ratio - 1).max() <= LEVELS.friction
        assert np.linalg.norm(env.model.cam_pos - plain.cam_pos, axis=1).max() < 6 * LEVELS.camera
    assert len(set(np.round(ratio, 6))) > 2


@pytest.mark.usefixtures("needs_gl")
def test_images_come_from_where_the_cameras_truly_are_and_calibrations_do_not() -> None:
    pictures, places = [], []
    for reality in (0.0, {"camera": 1.0}):
        env = gym.make(ID, obs_mode="rgbd", image_size=48, cameras=("gripper",), reality=reality)
        observation, info = env.reset(seed=0)
        pictures.append(observation["gripper_rgb"].astype(int))
        places.append(info["T_base_camera"]["gripper"])
        env.close()
    np.testing.assert_allclose(*places, atol=1e-9)
    assert np.abs(pictures[0] - pictures[1]).max() > 10


@pytest.mark.usefixtures("needs_gl")
def test_a_frame_that_is_seen_twice_is_handed_out_twice() -> None:
    env = gym.make(ID, obs_mode="rgbd", image_size=16, cameras=("gripper",), reality={"observation_delay": 1.0})
    first, second = env.reset(seed=0)[0], env.step(np.zeros(12))[0]
    assert np.array_equal(first["gripper_rgb"], second["gripper_rgb"]), "both are of the start"
    assert not any(np.shares_memory(first[name], second[name]) for name in first)
    env.close()


def test_a_dropped_frame_has_the_old_heights_too() -> None:
    env: Any = gym.make(ID, reality={"frames": 1.0}).unwrapped
    env.reset(seed=3)
    first, places = env.world.index.object_qpos.start, []
    for _ in range(60):
        env.data.qpos[first : first + 3] += (0.001, 0.0, 0.002)
        env.step(np.zeros(env.action_size))
        places.append(env._senses.measurements.poses[0, :3].copy())
    is_old = np.diff(places, axis=0) == 0
    assert 0 < is_old[:, 0].sum() < 30
    assert np.array_equal(is_old[:, 0], is_old[:, 2])


def test_misuse_is_refused_with_the_valid_choices() -> None:
    for cameras in ("head", ("head", "head"), None, [["head"], ["head"]]):
        with pytest.raises(ConfigError, match="different names"):
            gym.make(ID, obs_mode="rgbd", cameras=cameras)
    with pytest.raises(ConfigError, match="from 0 to 1"):
        gym.make(ID, reality=1.5)
    with pytest.raises(ConfigError, match=EFFECTS[0]):
        gym.make(ID, reality={"gravity": 0.5})
    with pytest.raises(ConfigError, match="reality"):
        gym.make("clutter_env/Reach-v0", reality=0.5)
    env = gym.make(ID, reality=0.5).unwrapped
    env.reset(seed=0)
    with pytest.raises(StateError, match="reality=0"):
        env.save_state()


@pytest.mark.parametrize("mode", ["joint", "ee"])
def test_a_differential_base_never_moves_sideways(mode: str) -> None:
    env = gym.make(ID, base="differential", control_mode=mode).unwrapped
    env.reset(seed=0)
    assert env.action_size == gym.make(ID, control_mode=mode).unwrapped.action_size - 1
    controller = env.world.controller
    for action in np.random.default_rng(1).uniform(-1, 1, (60, env.action_size)):
        x, y, yaw = controller.state.target[:3]
        env.step(action)
        moved = controller.state.target[:2] - (x, y)
        assert abs(np.cos(yaw) * moved[1] - np.sin(yaw) * moved[0]) < 1e-9
    assert np.hypot(*(env.data.qpos[env.world.index.drive_qpos[:2]] - env.world.scene.base[:2])) > 0.02


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1_000_004, 1_000_039])
def test_the_expert_looks_again_before_it_grasps(seed: int) -> None:
    env: Any = gym.make("clutter_env/Retrieve-o15-v0", obstructed=True, reality=0.5).unwrapped
    env.reset(seed=seed)
    expert = TampExpert(env)
    expert.reset()
    while not expert.done:
        env.step(expert.act())
    assert expert.report.clean, expert.report
    assert any(deviation.endswith(": moved") for deviation in expert.report.deviations), "it was planned from afar"
