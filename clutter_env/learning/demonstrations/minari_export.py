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
from clutter_env.learning.task import Task
from clutter_env.reporting.json_file import write_json

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
        steps = _write_episodes(dataset, seeds, data / "main_data.hdf5")
        write_json(data / "metadata.json", _metadata(dataset, dataset_id, about, len(seeds), steps, data))
        if final.exists():
            shutil.rmtree(final)
        os.replace(part, final)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return final


def _write_episodes(dataset: Dataset, seeds: list[int], path: Path) -> int:
    """All episodes in one file, numbered from 0; the number of their steps."""
    steps = 0
    with h5py.File(path, "w", track_order=True) as file:
        for index, seed in enumerate(seeds):
            with h5py.File(dataset.episode_path(seed), "r") as source:
                group = file.create_group(f"episode_{index}")
                for name in source:
                    source.copy(name, group)
                group.attrs.update({**dict(source.attrs), "id": index})
                steps += int(source.attrs["total_steps"])
    return steps


def _metadata(dataset: Dataset, dataset_id: str, about: str, episodes: int, steps: int, data: Path) -> dict[str, Any]:
    identity = dataset.identity
    env = Task(identity["task"]["env_id"], identity["task"]["keywords"]).make()
    try:
        assert env.spec is not None
        return {
            "dataset_id": dataset_id,
            "minari_version": MINARI_VERSION,
            "data_format": "hdf5",
            "jpeg_encoding": False,
            "total_episodes": episodes,
            "total_steps": steps,
            "dataset_size": round((data / "main_data.hdf5").stat().st_size / 1e6, 1),
            "observation_space": json.dumps(_space(env.observation_space)),
            "action_space": json.dumps(_space(env.action_space)),
            "env_spec": env.spec.to_json(),
            "algorithm_name": identity["expert"],
            "description": about,
            "requirements": [f"{name}=={identity['versions'][name]}" for name in ("mujoco", "gymnasium")],
            "versions": identity["versions"],
        }
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
