"""All episodes of a dataset in one HDF5 file, in our own layout or in that of robomimic."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from clutter_env.data.dataset import Dataset
from clutter_env.data.episode import Episode
from clutter_env.data.robomimic_env import GYM_TYPE, numbers_of, width_for
from clutter_env.errors import DatasetError
from clutter_env.reporting.files import written_atomically
from clutter_env.version import version

_ABOUT = (
    "gymnasium.make(env_name, **env_kwargs) after import clutter_env; robomimic's create_env_from_metadata works after "
    "clutter_env.data.robomimic_env.register(), its own wrapper is for the older gym"
)
_VALID = 10
"""Every tenth episode is for validation."""
_TEXT = h5py.string_dtype(encoding="utf-8")


def export_hdf5(dataset: Dataset, path: Path, robomimic: bool = False) -> Path:
    """Write a file that is either complete or absent, and return its path.

    Our layout has the groups episode_0, episode_1, … in the order of the seeds, each with the whole content of the
    episode's own file. robomimic's layout has data/demo_0/{obs, next_obs, actions, …}. Observations keep their names,
    and the last `dones` of an episode is 1. `states` begin with the seed, or with -1 if the episode began from options.
    MuJoCo's state and the full state follow, with which `reset_to` returns to any row. `mask/valid` names every tenth
    episode, `mask/train` the others.

    Raises:
        DatasetError: the file exists, or the dataset is not complete.
    """
    if path.exists():
        raise DatasetError(f"{path} exists; choose another file or remove it")
    seeds, identity, total = dataset.seeds, dataset.identity, 0
    with written_atomically(path) as part, h5py.File(part, "w", track_order=True) as file:
        file.attrs["provenance"] = json.dumps(identity.get("provenance"))
        if robomimic:
            data, task = file.create_group("data"), dataset.task
            for index, episode in enumerate(dataset):
                _write_demo(data.create_group(f"demo_{index}"), episode)
                total += len(episode)
            data.attrs["total"] = total
            data.attrs["env_args"] = json.dumps(
                {"env_name": task.env_id, "type": GYM_TYPE, "env_version": version(), "env_kwargs": dict(task.keywords)}
            )
            data.attrs["about"] = _ABOUT
            every, held_out = range(len(seeds)), slice(_VALID - 1, None, _VALID)
            masks = {"train": sorted({*every} - {*every[held_out]}), "valid": every[held_out]}
            for name, demos in masks.items():
                file.create_dataset(f"mask/{name}", data=[f"demo_{index}" for index in demos], dtype=_TEXT)
            return path
        for index, episode in enumerate(dataset):
            with h5py.File(dataset.episode_path(episode.seed), "r") as source:
                group = file.create_group(f"episode_{index}")
                for name in source:
                    source.copy(name, group)
                group.attrs.update({**dict(source.attrs), "id": index})
                total += len(episode)
        file.attrs["total_steps"], file.attrs["total_episodes"] = total, len(seeds)
    return path


def _write_demo(group: h5py.Group, episode: Episode) -> None:
    """Write one episode of T steps, with T rows in each array. `next_obs` is one step later."""
    group.attrs["num_samples"] = len(episode)
    group.attrs["seed"] = episode.seed
    dones = np.zeros(len(episode), np.int64)
    dones[-1:] = 1
    arrays: dict[str, NDArray[Any]] = {
        "actions": episode.actions,
        "rewards": episode.rewards,
        "dones": dones,
        "states": np.insert(episode.states[:-1], 0, episode.seed if episode.options is None else -1, axis=1),
    }
    if saved := episode.saved_states[:-1]:
        width = max(map(width_for, saved))
        arrays["states"] = np.hstack((arrays["states"], [numbers_of(state, width) for state in saved]))
    for name, values in episode.observations.items():
        arrays[f"obs/{name}"], arrays[f"next_obs/{name}"] = values[:-1], values[1:]
    for name, values in arrays.items():
        group.create_dataset(name, data=values, compression="gzip", compression_opts=1)
