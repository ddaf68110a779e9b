"""`make_env`: vectors of environments as LeRobot's evaluation wants them."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode

import clutter_env
from clutter_env.data.hub import make_env
from clutter_env.errors import ConfigError, UnknownTask

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


def test_cameras_take_the_place_of_exact_poses() -> None:
    pytest.importorskip("OpenGL")
    vector = make_env(cfg={"obs_mode": "rgbd", "image_size": 32})["clutter_env/Retrieve-o15-v0"][0]
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


def test_misuse_is_named() -> None:
    with pytest.raises(UnknownTask, match=r"known ones: .*Retrieve-o15"):
        make_env(cfg={"env_id": "clutter_env/Sort-v0"})
    with pytest.raises(ConfigError, match="at least 1"):
        make_env(0)
