"""All episodes of a dataset in one HDF5 file, each in a group with everything that its own file has."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

from clutter_env.learning.demonstrations.dataset import Dataset
from clutter_env.learning.errors import DatasetError
from clutter_env.reporting.files import written_atomically

__all__ = ["copy_episodes", "export_hdf5", "new_file"]


def export_hdf5(dataset: Dataset, path: Path) -> Path:
    """Write the groups episode_0, episode_1, … in the order of the seeds; the file.

    Raises:
        DatasetError: the file exists, or the dataset is not complete.
    """
    with new_file(path) as file:
        file.attrs["total_steps"] = copy_episodes(dataset, file)
        file.attrs["total_episodes"] = len(dataset)
    return path


def copy_episodes(dataset: Dataset, file: h5py.File) -> int:
    """Copy all episodes into groups of a file, numbered from 0; the number of their steps."""
    steps = 0
    for index, seed in enumerate(dataset.seeds):
        with h5py.File(dataset.episode_path(seed), "r") as source:
            group = file.create_group(f"episode_{index}")
            for name in source:
                source.copy(name, group)
            group.attrs.update({**dict(source.attrs), "id": index})
            steps += int(source.attrs["total_steps"])
    return steps


@contextmanager
def new_file(path: Path) -> Iterator[h5py.File]:
    """An HDF5 file that is there completely or not at all.

    Raises:
        DatasetError: the file exists.
    """
    if path.exists():
        raise DatasetError(f"{path} exists; choose another file or remove it")
    with written_atomically(path) as part, h5py.File(part, "w", track_order=True) as file:
        yield file
