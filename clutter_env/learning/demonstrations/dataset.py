"""A directory of demonstrations: one file per episode, named by its seed, and a record of what was tried in vain.

    dataset.json            the job: task, expert, how many episodes, first seed, versions
    episodes/seed_N.hdf5    an episode that succeeded and replays
    rejected/seed_N.json    a seed without a demonstration, and why
    index.json              once complete: the seeds in the dataset, in order

A seed is decided when it has one of the two files. The dataset is the first `episodes` seeds, counted upwards, that
have a demonstration: the same set however many processes worked on it and however often they were killed.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clutter_env.learning.demonstrations.episode import Episode
from clutter_env.learning.demonstrations.episode_file import read_episode
from clutter_env.learning.errors import DatasetError
from clutter_env.learning.task import Task, versions

__all__ = ["Dataset", "Job"]

_JOB, _INDEX, _EPISODES, _REJECTED = "dataset.json", "index.json", "episodes", "rejected"


@dataclass(frozen=True)
class Job:
    """What is to be collected: `episodes` successful episodes of `expert` on seeds from `first_seed` upwards."""

    task: Task
    expert: str
    episodes: int
    first_seed: int = 0
    options: Mapping[str, Any] | None = None

    def identity(self) -> dict[str, Any]:
        """All that decides what an episode of a seed looks like, as JSON values."""
        content = {"task": json.loads(self.task.to_json()), "expert": self.expert, "first_seed": self.first_seed}
        return {**content, "options": self.options, "versions": versions()}


@dataclass(frozen=True)
class Dataset:
    """A directory of demonstrations; see the module."""

    directory: Path

    @classmethod
    def open_for(cls, job: Job, directory: Path) -> Dataset:
        """The directory, made or continued, for this job.

        Raises:
            DatasetError: the directory holds something else; the message says what.
        """
        dataset = cls(directory)
        described = directory / _JOB
        if not described.exists():
            if directory.exists() and any(directory.iterdir()):
                raise DatasetError(f"{directory} exists and holds other files; choose another directory")
            (directory / _EPISODES).mkdir(parents=True, exist_ok=True)
            (directory / _REJECTED).mkdir(exist_ok=True)
            write_json(described, job.identity())
        there, wanted = json.loads(described.read_text()), job.identity()
        different = [name for name in wanted if there.get(name) != wanted[name]]
        if different:
            name = different[0]
            raise DatasetError(
                f"{directory} was collected with other {', '.join(different)} ({name}: {there.get(name)!r}, "
                f"now {wanted[name]!r}); choose another directory"
            )
        return dataset

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other collections out of the directory; the system lets go of the lock when the process ends.

        Raises:
            DatasetError: another process is collecting into the directory.
        """
        with (self.directory / ".lock").open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise DatasetError(f"another process is collecting into {self.directory}") from None
            yield

    @property
    def episodes_directory(self) -> Path:
        """Where the episodes' files are."""
        return self.directory / _EPISODES

    def episode_path(self, seed: int) -> Path:
        """The file of a seed's episode."""
        return self.episodes_directory / f"seed_{seed:07d}.hdf5"

    def put(self, seed: int, content: bytes) -> None:
        """Store the file of a seed's episode: whole, or not at all.

        Raises:
            OSError: the disk is full or cannot be written; what was stored before stays.
        """
        write_atomically(self.episode_path(seed), content)

    def reject(self, seed: int, reason: str) -> None:
        """Record that a seed gave no demonstration."""
        write_json(self._rejected_path(seed), {"seed": seed, "reason": reason})

    def is_decided(self, seed: int) -> bool:
        """Whether nothing remains to be done for a seed."""
        return self.has_episode(seed) or self._rejected_path(seed).exists()

    def has_episode(self, seed: int) -> bool:
        """Whether there is a demonstration of that seed."""
        return self.episode_path(seed).exists()

    def reasons(self) -> dict[int, str]:
        """Why seeds were rejected."""
        files = sorted((self.directory / _REJECTED).glob("seed_*.json"))
        entries = [json.loads(file.read_text()) for file in files]
        return {entry["seed"]: entry["reason"] for entry in entries}

    def chosen_seeds(self, job: Job) -> list[int] | None:
        """The dataset's seeds once they are known: all seeds up to the last of them are decided; None before."""
        chosen: list[int] = []
        seed = job.first_seed
        while len(chosen) < job.episodes:
            if not self.is_decided(seed):
                return None
            if self.has_episode(seed):
                chosen.append(seed)
            seed += 1
        return chosen

    def finish(self, seeds: Sequence[int]) -> None:
        """Write down which seeds make up the dataset."""
        write_json(self.directory / _INDEX, {"seeds": list(seeds)})

    @property
    def seeds(self) -> list[int]:
        """The seeds of a finished dataset.

        Raises:
            DatasetError: the directory holds no dataset, or an unfinished one.
        """
        index = self.directory / _INDEX
        if not index.exists():
            raise DatasetError(f"{self.directory} holds no finished dataset: run collect_demos.py to its end")
        return list(json.loads(index.read_text())["seeds"])

    @property
    def identity(self) -> dict[str, Any]:
        """What `Job.identity` said when the dataset was begun."""
        return dict(json.loads((self.directory / _JOB).read_text()))

    def __iter__(self) -> Iterator[Episode]:
        """The episodes in the order of their seeds, read one at a time."""
        for seed in self.seeds:
            yield read_episode(self.episode_path(seed))

    def __len__(self) -> int:
        return len(self.seeds)

    def _rejected_path(self, seed: int) -> Path:
        return self.directory / _REJECTED / f"seed_{seed:07d}.json"


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file: whole, or not at all."""
    write_atomically(path, json.dumps(content, indent=1).encode())


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file that appears under its name once it is on the disk; an old one stays until then."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
