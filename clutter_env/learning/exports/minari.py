"""A complete dataset as a Minari dataset, written in Minari's own layout.

`minari.load_dataset` and `MinariDataset(path)` read it; writing does not need Minari's `[create]` extra (jax), nor
Minari itself.
"""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import gymnasium as gym
import h5py
from gymnasium import spaces

from clutter_env.learning.demonstrations.dataset import Dataset
from clutter_env.learning.errors import DatasetError
from clutter_env.learning.exports.hdf5 import copy_episodes
from clutter_env.learning.task import Task
from clutter_env.reporting.files import write_json

__all__ = ["MINARI_VERSION", "export_minari"]

MINARI_VERSION = "0.5.3"
"""The version of Minari whose layout this is."""


def export_minari(dataset: Dataset, root: Path, dataset_id: str = "", replace: bool = False) -> Path:
    """Write the dataset below `root` (Minari's own is $MINARI_DATASETS_PATH or ~/.minari/datasets); its directory.

    Args:
        dataset: complete.
        root: directory of Minari datasets.
        dataset_id: such as "clutter_env/retrieve-o15-v0"; "" for the environment's id in lower case.
        replace: whether a dataset of that name is replaced.

    Raises:
        DatasetError: there is a dataset of that name already, or `dataset` is not complete.
    """
    seeds = dataset.seeds
    env_id = str(dataset.identity["task"]["env_id"])
    dataset_id = dataset_id or env_id.lower()
    about = f"{len(seeds)} demonstrations of {env_id}; every one replays bit for bit from its seed and actions."
    final = root / dataset_id
    if final.exists() and not replace:
        raise DatasetError(f"{final} exists; choose another dataset id or remove it")
    part = final.with_name(f".{final.name}.{os.getpid()}.part")
    data = part / "data"
    data.mkdir(parents=True)
    try:
        with h5py.File(data / "main_data.hdf5", "w", track_order=True) as file:
            steps = copy_episodes(dataset, file)
        write_json(data / "metadata.json", _metadata(dataset, dataset_id, about, len(seeds), steps, data))
        if final.exists():
            shutil.rmtree(final)
        os.replace(part, final)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return final


def _metadata(dataset: Dataset, dataset_id: str, about: str, episodes: int, steps: int, data: Path) -> dict[str, Any]:
    identity = dataset.identity
    task = Task(identity["task"]["env_id"], identity["task"]["keywords"])
    env = task.make()
    try:
        assert env.spec is not None
        assert isinstance(env.observation_space, spaces.Dict)
        observations = {**_image_spaces(task, identity.get("image_size", 0)), **env.observation_space.spaces}
        return {
            "dataset_id": dataset_id,
            "minari_version": MINARI_VERSION,
            "data_format": "hdf5",
            "jpeg_encoding": False,
            "total_episodes": episodes,
            "total_steps": steps,
            "dataset_size": round((data / "main_data.hdf5").stat().st_size / 1e6, 1),
            "observation_space": json.dumps(_space(spaces.Dict(observations))),
            "action_space": json.dumps(_space(env.action_space)),
            "env_spec": env.spec.to_json(),
            "algorithm_name": identity["expert"],
            "description": about,
            "requirements": [f"{name}=={identity['versions'][name]}" for name in ("mujoco", "gymnasium")],
            "versions": identity["versions"],
        }
    finally:
        env.close()


def _image_spaces(task: Task, image_size: int) -> dict[str, gym.Space[Any]]:
    """The spaces of the images that a dataset has; none without images."""
    if not image_size:
        return {}
    env = task.make(obs_mode="rgbd", image_size=image_size)
    try:
        assert isinstance(env.observation_space, spaces.Dict)
        return dict(env.observation_space.spaces)
    finally:
        env.close()


def _space(space: gym.Space) -> dict[str, Any]:
    """A space as Minari describes it."""
    if isinstance(space, spaces.Dict):
        return {"type": "Dict", "subspaces": {name: _space(part) for name, part in space.spaces.items()}}
    if isinstance(space, spaces.Box):
        low, high = space.low.tolist(), space.high.tolist()
        return {"type": "Box", "dtype": str(space.dtype), "shape": list(space.shape), "low": low, "high": high}
    raise DatasetError(f"no Minari description of {space}")
