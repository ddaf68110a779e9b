"""`ArmRetrieve`: within reach in 100 steps, an object in the way in half of the scenes, one vector observed."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from clutter_env.envs.arm_retrieve import (
    BLOCKED_SHARE,
    GAP,
    OBJECT_ROW,
    OTHER_HEIGHT,
    ROLE_ROW,
    TARGET_HEIGHT,
    UNIT,
)
from clutter_env.envs.from_above import Standing
from clutter_env.errors import ActionError, ConfigError, OptionError
from clutter_env.policies.experts import find_expert, make_expert

IDS = [f"clutter_env/ArmRetrieve-o{count}-v0" for count in (1, 3, 5)]


def play(env, seed):
    """The last info of the script's episode in a scene."""
    script = make_expert("armretrieve")
    observation, info = env.reset(seed=seed)
    script.reset(info, env)
    for _ in range(100):
        observation, _, terminated, truncated, info = env.step(script.act(observation))
        if terminated or truncated:
            break
    return info


@pytest.mark.parametrize("env_id", IDS)
def test_the_script_takes_nearly_every_target_clean_within_the_time(env_id: str) -> None:
    assert find_expert(env_id) == "armretrieve"
    env = gym.make(env_id)
    assert env.spec.max_episode_steps == 100
    results = [play(env, seed)["is_success"] for seed in range(16)]
    assert sum(results) >= 15


@pytest.mark.parametrize("env_id", IDS)
def test_checkers_are_silent(env_id: str) -> None:
    from stable_baselines3.common.env_checker import check_env as check_for_sb3

    check_env(gym.make(env_id).unwrapped, skip_render_check=True)
    check_for_sb3(gym.make(env_id).unwrapped)


def test_half_of_the_scenes_have_one_object_in_the_way_that_can_be_taken_first() -> None:
    env = gym.make(IDS[2]).unwrapped
    blocked = 0
    for seed in range(60):
        env.reset(seed=seed)
        scene, standing = env.world.scene, env.standing()
        assert len(env.in_the_way) <= 1
        blocked += len(env.in_the_way)
        assert not any(standing.in_the_way(slot, 0.04) for slot in env.in_the_way)
        tops = 2 * scene.half_extents[:, 2]
        others = np.delete(tops, scene.target)
        assert TARGET_HEIGHT[0] <= tops[scene.target] <= TARGET_HEIGHT[1]
        assert OTHER_HEIGHT[0] <= others.min()
        assert others.max() <= OTHER_HEIGHT[1]
        gaps = np.hypot(*(scene.positions[:, None] - scene.positions).transpose(2, 0, 1))
        gaps -= scene.half_extents[:, 0][:, None] + scene.half_extents[:, 0]
        assert gaps[~np.eye(5, dtype=bool)].min() >= GAP - 1e-9
    assert abs(blocked / 60 - BLOCKED_SHARE) < 0.25


def test_observations_are_those_of_the_layout() -> None:
    env = gym.make(IDS[1]).unwrapped
    observation, info = env.reset(seed=5)
    layout = env.observation_layout["observation"]
    assert env.observation_space.contains(observation)
    observation = observation["observation"]
    assert layout.size == len(observation)
    assert env.object_names[env.object_order[0]] == info["target"]
    poses, origin = env.measurements.poses, env.origin
    for row, slot in enumerate(env.object_order):
        values = observation[layout[f"object_{row}"]]
        assert values[OBJECT_ROW["is_target"]] == (row == 0)
        assert np.allclose(values[OBJECT_ROW["from_tcp"]] * UNIT, poses[slot, :3] - origin - env.tcp, atol=1e-5)
        base = origin if row == 0 else poses[env.target_slot, :3]
        assert np.allclose(values[OBJECT_ROW["from_target"]] * UNIT, poses[slot, :3] - base, atol=1e-5)
        assert np.allclose(values[OBJECT_ROW["axis"]], (0, 0, 1), atol=1e-3)
    assert np.abs(observation[layout["tcp_position"]]).max() < 0.02
    slots = gym.make(IDS[1], object_order="slots").unwrapped
    slots.reset(seed=5)
    assert slots.object_order == (0, 1, 2)


def test_with_roles_each_row_says_whether_its_object_is_in_the_way() -> None:
    """From before it is taken until it is put aside; all other numbers are as without."""
    env, plain = gym.make(IDS[1], roles=True).unwrapped, gym.make(IDS[1]).unwrapped
    check_env(gym.make(IDS[1], roles=True).unwrapped, skip_render_check=True)
    script = make_expert("armretrieve")
    seed = next(seed for seed in range(20) if env.reset(seed=seed) and env.in_the_way)
    (observation, info), (without, _) = env.reset(seed=seed), plain.reset(seed=seed)
    script.reset(info, env)
    place, found = env.observation_layout["observation"]["object_0"].start, set()
    for _ in range(100):
        rows = observation["observation"][place:].reshape(3, ROLE_ROW.size)
        shown = {slot for slot, row in zip(env.object_order, rows, strict=True) if row[ROLE_ROW["in_the_way"]]}
        assert shown == set(env.in_the_way)
        assert np.array_equal(observation["observation"][:place], without["observation"][:place])
        assert np.array_equal(rows[:, : OBJECT_ROW.size].ravel(), without["observation"][place:])
        found.add(tuple(shown))
        action = script.act(observation)
        (observation, _, is_over, _, info), (without, *_) = env.step(action), plain.step(action)
        if is_over:
            break
    assert info["is_success"]
    assert len(found) == 2
    assert env.observation_layout["observation"].index("object_1.in_the_way") == place + 2 * ROLE_ROW.size - 1


def test_the_next_state_follows_from_what_is_saved() -> None:
    env, other = gym.make(IDS[1]).unwrapped, gym.make(IDS[1]).unwrapped
    script = make_expert("armretrieve")
    observation, info = env.reset(seed=1)
    script.reset(info, env)
    for _ in range(12):
        env.step(script.act(observation))
    other.reset(options={"state": env.save_state()})
    for _ in range(10):
        action = script.act(observation)
        one, two = env.step(action), other.step(action)
        assert np.array_equal(one[0]["observation"], two[0]["observation"])
        assert one[1:4] == two[1:4]


def test_saving_a_state_does_not_read_the_robot_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its file was read and hashed for each of the states of a demonstration: three quarters of the time."""
    env = gym.make(IDS[0]).unwrapped
    env.reset(seed=0)
    saved = env.save_state()
    monkeypatch.setattr(Path, "read_bytes", lambda *_: pytest.fail("the robot's file was read again"))
    assert env.save_state() == saved


def test_the_terms_of_the_reward_are_computed_once_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    env = gym.make(IDS[1]).unwrapped
    env.reset(seed=0)
    calls = []
    nearness = type(env)._nearness
    monkeypatch.setattr(type(env), "_nearness", lambda *given: calls.append(1) or nearness(*given))
    for _ in range(5):
        env.step(np.zeros(4))
    assert len(calls) == 5


def test_an_episode_ends_when_success_has_become_impossible() -> None:
    env, lenient = gym.make(IDS[2]), gym.make(IDS[2], success="lifted")
    for each in (env, lenient):
        each.reset(seed=0)
    ended = False
    for _ in range(100):
        action = np.array([0.6, 0.8, -1.0, -1.0])
        *_, ended, _, info = env.step(action)
        *_, goes_on, _, _ = lenient.step(action)
        if ended:
            break
    assert ended
    assert not info["is_success"]
    assert not goes_on


def test_seven_numbers_turn_the_gripper_and_zeros_keep_it() -> None:
    env = gym.make(IDS[0], turns=True).unwrapped
    check_env(env, skip_render_check=True)
    observation, _ = env.reset(seed=0)
    layout = env.observation_layout["observation"]
    assert env.action_space.shape == (7,)
    start = observation["observation"][layout["tcp_quaternion"]]
    for _ in range(10):
        observation, *_ = env.step([0, 0, 0, 0, 0, 0, 1])
    assert abs(observation["observation"][layout["tcp_quaternion"]] @ start) > np.cos(0.02)
    for _ in range(8):
        observation, *_ = env.step([0, 0, 0, 0, 0, 0.5, 1])
    turned = 2 * np.arccos(min(abs(float(observation["observation"][layout["tcp_quaternion"]] @ start)), 1.0))
    assert 0.4 < turned < 1.2
    with pytest.raises(ActionError, match="seven"):
        env.arm_action((0, 0, 0), 0.1)


def test_what_is_in_the_way_of_a_gripper_from_above() -> None:
    """Beside a finger or under the palm, if it is high enough; ahead of the fingers there is room."""
    centres = np.array([(0.0, 0.0), (0.0, 0.075), (0.075, 0.0), (0.0, -0.2)])
    low, high = np.full(4, 0.04), np.array([0.04, 0.12, 0.12, 0.12])
    widths = np.full(4, 0.03)
    assert Standing(centres, widths, low).in_the_way(0, 0.04) == [1]
    assert Standing(centres, widths, high).in_the_way(0, 0.04) == [1, 2]
    assert Standing(centres, widths, low).in_the_way(0, 0.04, heading=np.pi / 2) == [2]
    assert Standing(centres, widths, high).in_the_way(1, 0.04) == []


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"control_mode": "joint"}, "control_mode"),
        ({"obs_mode": "rgbd"}, "obs_mode"),
        ({"obstructed": True}, "obstructed"),
        ({"reward_mode": "dense"}, "reward_mode"),
        ({"object_order": "nearest"}, "object_order"),
        ({"roles": 2}, "roles"),
        ({"robot": "pr2"}, "behind the front edge"),
    ],
)
def test_what_it_cannot_be_is_refused(keywords: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        gym.make(IDS[0], **keywords)


def test_options_of_other_tasks_are_refused_and_own_scenes_taken() -> None:
    env = gym.make(IDS[1]).unwrapped
    with pytest.raises(OptionError, match="obstructed"):
        env.reset(seed=0, options={"obstructed": True})
    cylinder = {"shape": "cylinder", "radius": 0.03, "height": 0.05}
    objects = [{**cylinder, "position": (x, 0.1)} for x in (-0.1, 0.05)]
    observation, info = env.reset(seed=0, options={"objects": objects, "target": "object_01"})
    assert info["target"] == "object_01"
    assert env.observation_space.contains(observation)
    assert not observation["observation"][env.observation_layout["observation"]["object_2"]].any()
