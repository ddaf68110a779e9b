"""Every row of a demonstration is a state from which an episode goes on, bit for bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from clutter_env.data.dataset import Dataset, Job
from clutter_env.data.episode import Episode
from clutter_env.data.episode_file import read_episode, write_episode
from clutter_env.data.hdf5 import export_hdf5
from clutter_env.data.resets import FromDemonstrations, demonstration_resets
from clutter_env.data.robomimic_env import RobomimicEnv
from clutter_env.errors import DatasetError, LearningError
from clutter_env.seeds import HELD_OUT
from clutter_env.simulation.saved_state import join_states, split_states
from clutter_env.task import Task
from tests.clutter_env.data.conftest import recorded, stored

ARM = Task("clutter_env/ArmRetrieve-o3-v0")
SEEDS = (0, 1)


@pytest.fixture(scope="module")
def episodes() -> list[Episode]:
    return [recorded(ARM, "armretrieve", seed) for seed in SEEDS]


@pytest.fixture(scope="module")
def dataset(episodes: list[Episode], tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return stored(episodes, Job(ARM, "armretrieve", len(SEEDS)), tmp_path_factory.mktemp("arm"))


@pytest.mark.parametrize("row", [0, 7, -2])
def test_an_episode_goes_on_from_every_row_of_its_file(dataset: Dataset, row: int) -> None:
    episode = next(iter(dataset))
    assert len(episode.saved_states) == len(episode) + 1
    env = ARM.make()
    observation, _ = env.reset(options={"state": episode.saved_states[row]})
    first = row % (len(episode) + 1)
    for step in range(first, len(episode)):
        assert np.array_equal(observation["observation"], episode.observations["observation"][step])
        observation, reward, terminated, _, info = env.step(episode.actions[step])
        assert reward == episode.rewards[step]
    assert terminated
    assert info["is_success"]


def test_states_together_take_half_the_space_and_come_back_bit_for_bit(episodes: list[Episode]) -> None:
    states = episodes[0].saved_states
    together = join_states(states)
    assert split_states(together) == states
    assert len(together) < sum(map(len, states)) / 2
    with pytest.raises(ValueError, match="states"):
        split_states(together[:-40])


def test_planned_episodes_have_them_too(planned_episode: Episode) -> None:
    env = planned_episode.task.make()
    state = planned_episode.saved_states[40]
    observation, _ = env.reset(options={"state": state})
    assert all(np.array_equal(observation[name], planned_episode.observations[name][40]) for name in observation)


def test_files_without_states_are_read_and_refused_for_resets(episodes: list[Episode], tmp_path: Path) -> None:
    """Those of earlier versions, and of worlds whose state cannot be saved."""
    path = tmp_path / "old.hdf5"
    write_episode(path, episodes[0])
    with h5py.File(path, "a") as file:
        del file["saved_states"]
    assert read_episode(path).saved_states == ()
    with pytest.raises(DatasetError, match="no states"):
        demonstration_resets([read_episode(path)])
    rough = Task("clutter_env/Retrieve-o1-v0", {"reality": 0.5, "control_mode": "ee"})
    assert recorded(rough, "scripted", 0).saved_states == ()


def test_files_with_wrong_states_are_refused(episodes: list[Episode], tmp_path: Path) -> None:
    path = tmp_path / "wrong.hdf5"
    write_episode(path, replace(episodes[0], saved_states=episodes[0].saved_states[:-1]))
    with pytest.raises(DatasetError, match="states"):
        read_episode(path)
    with h5py.File(path, "a") as file:
        del file["saved_states"]
        file["saved_states"] = np.arange(50, dtype=np.uint8)
    with pytest.raises(DatasetError, match="states"):
        read_episode(path)


def test_resets_are_drawn_from_the_last_steps_of_all_demonstrations(dataset: Dataset, episodes: list[Episode]) -> None:
    resets, rng = demonstration_resets(dataset), np.random.default_rng(0)
    last = {state for episode in episodes for state in episode.saved_states[-6:-1]}
    drawn = {resets.draw(rng, within=5)["state"] for _ in range(200)}
    assert drawn == last
    everywhere = {resets.draw(rng)["state"] for _ in range(3000)}
    assert everywhere == {state for episode in episodes for state in episode.saved_states[:-1]}
    with pytest.raises(LearningError, match="within"):
        resets.draw(rng, within=0)


def test_a_wrapper_mixes_resets_with_scenes_to_learn_from(dataset: Dataset) -> None:
    """A restored state brings its random generator along, which must not decide the scenes that follow."""
    env = FromDemonstrations(ARM.make(), demonstration_resets(dataset), share=0.5)
    firsts, times = [], []
    env.reset(seed=3)
    for _ in range(40):
        observation, _ = env.reset()
        firsts.append(observation["observation"].tobytes())
        times.append(env.unwrapped.data.time > 0)
        assert env.unwrapped.np_random_seed is None or env.unwrapped.np_random_seed < HELD_OUT
    assert 8 < sum(times) < 32
    fresh = [first for first, is_late in zip(firsts, times, strict=True) if not is_late]
    assert len(set(fresh)) == len(fresh)
    again = FromDemonstrations(ARM.make(), demonstration_resets(dataset), share=0.5)
    again.reset(seed=3)
    assert [again.reset()[0]["observation"].tobytes() for _ in range(40)] == firsts
    env.share = 0.0
    env.reset()
    assert env.unwrapped.data.time == 0


def test_robomimic_returns_to_any_row(dataset: Dataset, episodes: list[Episode], tmp_path: Path) -> None:
    with h5py.File(export_hdf5(dataset, tmp_path / "demo.hdf5", robomimic=True), "r") as file:
        states, actions = (file[f"data/demo_1/{name}"][:] for name in ("states", "actions"))
    env = RobomimicEnv(ARM.env_id)
    row = 20
    seen = env.reset_to({"states": states[row]})
    np.testing.assert_array_equal(seen["observation"], episodes[1].observations["observation"][row])
    middle = env.get_state()["states"]
    for action in actions[row:]:
        env.step(action)
    assert env.is_success() == {"task": True}
    again = env.reset_to({"states": middle})
    np.testing.assert_array_equal(again["observation"], seen["observation"])
