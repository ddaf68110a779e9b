"""Episodes and datasets that the tests of data share: each is recorded once."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("h5py")

from clutter_env.data.dataset import Dataset, Job
from clutter_env.data.episode import Episode, record
from clutter_env.data.episode_file import write_episode
from clutter_env.policies.experts import make_expert
from clutter_env.task import Task

PICK = Task("clutter_env/Pick-v0")
RETRIEVE = Task("clutter_env/Retrieve-o1-v0")


def recorded(task: Task, expert: str, seed: int) -> Episode:
    env = task.make()
    try:
        return record(task, env, make_expert(expert), seed)
    finally:
        env.close()


def stored(episodes: list[Episode], job: Job, folder: Path) -> Dataset:
    """A complete dataset of these episodes."""
    dataset = Dataset.open_for(job, folder / "demos")
    for episode in episodes:
        write_episode(dataset.episode_path(episode.seed), episode)
    dataset.finish([episode.seed for episode in episodes])
    return dataset


@pytest.fixture(scope="session")
def pick_episode() -> Episode:
    """An episode of the script."""
    return recorded(PICK, "pick", seed=3)


@pytest.fixture(scope="session")
def planned_episode() -> Episode:
    """An episode of the planner, whose steps have labels."""
    return recorded(RETRIEVE, "canonical", seed=0)


@pytest.fixture(scope="session")
def planned_dataset(planned_episode: Episode, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return stored([planned_episode], Job(RETRIEVE, "canonical", 1), tmp_path_factory.mktemp("planned"))


@pytest.fixture(scope="session")
def pick_file(pick_episode: Episode, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("episodes") / "good.hdf5"
    write_episode(path, pick_episode)
    return path
