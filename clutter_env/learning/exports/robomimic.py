"""A complete dataset as an HDF5 file in the layout of robomimic: data/demo_0/{obs, next_obs, actions, …}."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.demonstrations.dataset import Dataset
from clutter_env.learning.demonstrations.episode import Episode
from clutter_env.learning.exports.hdf5 import new_file

__all__ = ["export_robomimic"]

_GYM_TYPE = 2
"""robomimic's number of Gymnasium environments (`EnvType.GYM_TYPE`)."""
_TEXT = h5py.string_dtype(encoding="utf-8")


def export_robomimic(dataset: Dataset, path: Path) -> Path:
    """Write the file; observations keep their names, the last `dones` of an episode is 1, `mask/train` names all.

    Raises:
        DatasetError: the file exists, or the dataset is not complete.
    """
    task = dataset.identity["task"]
    arguments = {"env_name": task["env_id"], "type": _GYM_TYPE, "env_kwargs": dict(task["keywords"])}
    with new_file(path) as file:
        data = file.create_group("data")
        total = 0
        for index, episode in enumerate(dataset):
            _write_demo(data.create_group(f"demo_{index}"), episode)
            total += len(episode)
        data.attrs["total"] = total
        data.attrs["env_args"] = json.dumps(arguments)
        file.create_dataset("mask/train", data=[f"demo_{index}" for index in range(len(dataset))], dtype=_TEXT)
    return path


def _write_demo(group: h5py.Group, episode: Episode) -> None:
    """One episode of T steps: T rows in each array; `next_obs` is one step later."""
    group.attrs["num_samples"] = len(episode)
    group.attrs["seed"] = episode.seed
    dones = np.zeros(len(episode), np.int64)
    dones[-1:] = 1
    arrays: dict[str, NDArray[Any]] = {
        "actions": episode.actions,
        "rewards": episode.rewards,
        "dones": dones,
        "states": episode.states[:-1],
    }
    for name, values in episode.observations.items():
        arrays[f"obs/{name}"], arrays[f"next_obs/{name}"] = values[:-1], values[1:]
    for name, values in arrays.items():
        group.create_dataset(name, data=values, compression="gzip", compression_opts=1)
