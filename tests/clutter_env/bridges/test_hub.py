"""`make_env`: vectors of environments as LeRobot's evaluation wants them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode

import clutter_env
from clutter_env.bridges.hub import OBSERVATIONS, make_env, make_one
from clutter_env.errors import ConfigError, OptionError, UnknownTask
from clutter_env.suites import suite

assert clutter_env  # registers the environments


def test_observations_have_the_hub_s_keys_and_episodes_end_with_their_result() -> None:
    env_id = "clutter_env/Retrieve-o5-v0"
    vector = make_env(2, cfg={"env_id": env_id, "max_episode_steps": 4})[env_id][0]
    assert vector.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    observations, infos = vector.reset(seed=[0, 1])
    assert set(observations) == {"agent_pos", "environment_state"}
    assert observations["agent_pos"].shape == (2, *vector.single_observation_space["agent_pos"].shape)
    assert vector.single_observation_space.contains({name: values[0] for name, values in observations.items()})
    assert infos["is_success"].tolist() == [False, False]
    assert vector.call("task_description") == ("take the target out of the clutter",) * 2
    for step in range(4):
        before = observations
        observations, _, _, truncated, infos = vector.step(np.zeros(vector.action_space.shape, np.float32))
        assert truncated.tolist() == [step == 3] * 2
    assert infos["final_info"]["is_success"].tolist() == [False, False]
    assert not np.array_equal(observations["environment_state"], before["environment_state"]), "a new scene"
    vector.close()


def test_scenes_of_a_suite_are_named_by_their_seeds_and_said_in_words() -> None:
    scenes = suite("side-15-v3").test
    env = make_one(suite="side-15-v3", language=True)
    for seed, number in ((0, 0), (101, 1), (None, 2)):
        _, info = env.reset(seed=seed)
        assert info["target"] == scenes[number].target
        assert env.get_wrapper_attr("task_description") == f"Pick up the {info['target'].replace('_', ' ')}."
        assert env.get_wrapper_attr("_max_episode_steps") == scenes[number].max_steps
    with pytest.raises(OptionError, match="without options"):
        env.reset(options={"target": "object_00"})
    env.close()
    vector = make_env(2, cfg={"suite": "side-15-v3", "language": True, "env_id": "side-15-v3"})["side-15-v3"][0]
    vector.reset(seed=[0, 1])
    said = [f"Pick up the {scene.target.replace('_', ' ')}." for scene in scenes[:2]]
    assert list(vector.call("task_description")) == said
    vector.close()


def test_cameras_take_the_place_of_exact_poses() -> None:
    pytest.importorskip("OpenGL")
    vector = make_env(cfg={"observations": "images", "image_size": 32})["clutter_env/Retrieve-o15-v0"][0]
    space = vector.single_observation_space
    assert set(space) == {"agent_pos", "pixels"}
    assert space["pixels"]["head"].shape == (32, 32, 3)
    vector.close()


@pytest.mark.slow
def test_each_environment_can_have_a_process() -> None:
    vector = make_env(2, use_async_envs=True, cfg={"env_id": "clutter_env/Reach-v0"})["clutter_env/Reach-v0"][0]
    assert isinstance(vector, AsyncVectorEnv)
    observations, _ = vector.reset(seed=0)
    assert len(observations["agent_pos"]) == 2
    vector.close()


@pytest.mark.usefixtures("needs_gl")
@pytest.mark.parametrize("name", ["Retrieve-o1", "ArmPick", "Pick"])
def test_beside_images_no_number_tells_where_the_object_is(name: str) -> None:
    """Everything but the images is the same for two scenes that differ in the object's place alone."""
    env = make_one(f"clutter_env/{name}-v0", "images", image_size=16)
    seen = []
    for shift in (0.0, 0.05):
        env.reset(seed=0)
        inner = env.unwrapped
        inner.measurements = replace(inner.measurements, poses=inner.measurements.poses + shift)
        seen.append(env.observation(inner._observe()))
    env.close()
    np.testing.assert_array_equal(seen[0]["agent_pos"], seen[1]["agent_pos"])
    assert set(seen[0]) == {"agent_pos", "pixels"}


@pytest.mark.parametrize("name", ["Retrieve-o1", "ArmPick", "Rearrange-o4"])
def test_one_vector_and_two_hold_the_same_numbers(name: str) -> None:
    found = {}
    for observations in OBSERVATIONS[1:]:
        env = make_one(f"clutter_env/{name}-v0", observations)
        found[observations], _ = env.reset(seed=0)
        assert env.observation_space.contains(found[observations])
        assert sum(map(np.size, found[observations].values())) == sum(
            part.shape[0] for part in env.unwrapped.observation_space.values()
        )
        env.close()
    apart = found["environment_state"]
    np.testing.assert_array_equal(found["state"]["agent_pos"], np.concatenate(list(apart.values())))


def test_misuse_is_named() -> None:
    with pytest.raises(ConfigError, match="'images', 'state', 'environment_state'"):
        make_env(cfg={"observations": "exact"})
    with pytest.raises(ConfigError, match="Skill-o5-v0 is not for LeRobot"):
        make_env(cfg={"env_id": "clutter_env/Skill-o5-v0"})
    with pytest.raises(UnknownTask, match=r"known ones: .*Retrieve-o15"):
        make_env(cfg={"env_id": "clutter_env/Sort-v0"})
    with pytest.raises(ConfigError, match="at least 1"):
        make_env(0)
