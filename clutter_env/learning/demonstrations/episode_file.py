"""One episode as one HDF5 file: the layout of a Minari episode, and further data that Minari does not need.

    observations/…  actions  rewards  terminations  truncations  infos/{is_success, num_fallen, state, skill}
    expert/{plan, report, skills}  attributes: id, seed, total_steps, options, task, versions

`infos/skill` holds an index into the names in `expert/skills`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.demonstrations.episode import Episode
from clutter_env.learning.errors import DatasetError
from clutter_env.learning.task import Task

__all__ = ["read_episode", "write_episode"]

_COMPRESSION: Mapping[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
_TEXT = h5py.string_dtype(encoding="utf-8")


def write_episode(path: Path, episode: Episode) -> None:
    """Write the file.

    Raises:
        OSError: the disk is full or cannot be written.
    """
    with h5py.File(path, "w") as file:
        _write(file, episode)


def read_episode(path: Path) -> Episode:
    """The episode in that file.

    Raises:
        DatasetError: there is no such file, or it holds no episode.
    """
    try:
        with h5py.File(path, "r") as file:
            return _read(file)
    except (OSError, KeyError) as problem:
        raise DatasetError(f"{path} holds no episode of this package: {problem}") from problem


def _write(file: h5py.File, episode: Episode) -> None:
    steps = len(episode)
    file.attrs.update(
        {
            "id": 0,
            "seed": episode.seed,
            "total_steps": steps,
            "options": json.dumps(episode.options),
            "task": episode.task.to_json(),
            "versions": json.dumps(dict(episode.versions)),
        }
    )
    ends = np.zeros((2, steps), dtype=bool)
    ends[:, -1] = episode.terminated, episode.truncated
    names = sorted(set(episode.skills))
    arrays: dict[str, NDArray[Any]] = {f"observations/{name}": value for name, value in episode.observations.items()}
    arrays |= {"actions": episode.actions, "rewards": episode.rewards, "terminations": ends[0], "truncations": ends[1]}
    arrays["infos/is_success"] = episode.is_success
    arrays["infos/num_fallen"] = episode.num_fallen
    arrays["infos/state"] = episode.states
    arrays["infos/skill"] = np.array([names.index(name) for name in episode.skills], np.int64)
    for name, values in arrays.items():
        file.create_dataset(name, data=values, chunks=True, **_COMPRESSION)
    file.create_dataset("expert/plan", data=episode.plan, dtype=_TEXT)
    file.create_dataset("expert/report", data=json.dumps(dict(episode.report)), dtype=_TEXT)
    file.create_dataset("expert/skills", data=names, dtype=_TEXT)


def _read(file: h5py.File) -> Episode:
    names = [name.decode() for name in file["expert/skills"][()]]
    return Episode(
        task=Task.from_json(file.attrs["task"]),
        seed=int(file.attrs["seed"]),
        options=json.loads(file.attrs["options"]),
        observations={name: values[()] for name, values in file["observations"].items()},
        actions=file["actions"][()],
        rewards=file["rewards"][()],
        terminated=bool(file["terminations"][-1]),
        truncated=bool(file["truncations"][-1]),
        is_success=file["infos/is_success"][()],
        num_fallen=file["infos/num_fallen"][()],
        states=file["infos/state"][()],
        skills=tuple(names[index] for index in file["infos/skill"][()]),
        plan=file["expert/plan"][()].decode(),
        report=json.loads(file["expert/report"][()]),
        versions=json.loads(file.attrs["versions"]),
    )
