"""A directory of demonstrations: one file per episode, named by its seed, and one per seed without a demonstration.

    dataset.json            the job: task, expert, first seed; and what it was collected with
    episodes/seed_N.hdf5    an episode that succeeded and replays
    rejected/seed_N.json    a seed without a demonstration, and the reason
    index.json              once the collection is complete: the seeds of the dataset, in order

A seed is decided when it has an episode or a rejection. The dataset is the first `episodes` seeds, in ascending order,
that have an episode: the same set for every number of processes and of interruptions.
"""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clutter_env.data.episode import Episode
from clutter_env.data.episode_file import read_episode
from clutter_env.errors import DatasetError
from clutter_env.provenance import differences
from clutter_env.reporting.files import changes, json_text, write_atomically, write_json
from clutter_env.seeds import training_seeds
from clutter_env.task import Task

_JOB, _INDEX, _EPISODES, _REJECTED = "dataset.json", "index.json", "episodes", "rejected"
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Job:
    """A job of collection: `episodes` successful episodes of `expert` on seeds from `first_seed` upwards.

    With an `image_size` [pixels] each observation also gets the images of the robot's cameras.
    """

    task: Task
    expert: str
    episodes: int
    first_seed: int = 0
    options: Mapping[str, Any] | None = None
    image_size: int = 0

    def identity(self) -> dict[str, Any]:
        """The settings that determine the episode of a seed, as JSON values."""
        content: dict[str, Any] = {"task": self.task, "expert": self.expert, "first_seed": self.first_seed}
        if self.image_size:
            content["image_size"] = self.image_size
        return dict(json.loads(json_text({**content, "options": self.options})))


@dataclass(frozen=True)
class Dataset:
    """A directory of demonstrations, see the module's docstring."""

    directory: Path

    @classmethod
    def open_for(cls, job: Job, directory: Path) -> Dataset:
        """The dataset of a job in a directory, which is made if it does not exist.

        Raises:
            DatasetError: the directory holds other files, or episodes of another job or of another version of this
                environment. The message names the differences.
        """
        dataset = cls(directory)
        wanted, present = job.identity(), job.task.provenance()
        if not (directory / _JOB).exists():
            if directory.exists() and any(directory.iterdir()):
                raise DatasetError(f"{directory} exists and holds other files; choose another directory")
            (directory / _EPISODES).mkdir(parents=True, exist_ok=True)
            (directory / _REJECTED).mkdir(exist_ok=True)
            write_json(directory / _JOB, {**wanted, "provenance": present})
        there = dataset.identity
        compared = {name: there.get(name) for name in (*wanted, "image_size") if name in there or name in wanted}
        if different := changes(compared, wanted):
            raise DatasetError(
                f"{directory} was collected with other settings ({'; '.join(different)}); choose another directory"
            )
        if changed := differences(there.get("provenance"), present):
            raise DatasetError(
                f"{directory} cannot be continued, its episodes would not be alike. {' '.join(changed)} Choose another "
                "directory."
            )
        return dataset

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other collections out of the directory. The system releases the lock when the process ends.

        Raises:
            DatasetError: another process is collecting into the directory.
        """
        with (self.directory / ".lock").open("w") as file:
            try:
                if sys.platform == "win32":
                    import msvcrt

                    msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
                else:
                    import fcntl

                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except (BlockingIOError, PermissionError):  # the second on Windows
                raise DatasetError(f"another process is collecting into {self.directory}") from None
            yield

    @property
    def episodes_directory(self) -> Path:
        """Directory of the episodes' files."""
        return self.directory / _EPISODES

    def episode_path(self, seed: int) -> Path:
        """The file of a seed's episode."""
        return self.episodes_directory / f"seed_{seed:07d}.hdf5"

    def put(self, seed: int, content: bytes) -> None:
        """Store the file of a seed's episode, completely or not at all.

        Raises:
            OSError: the disk is full or cannot be written. Earlier files stay.
        """
        write_atomically(self.episode_path(seed), content)

    def reject(self, seed: int, reason: str) -> None:
        """Store the reason why a seed has no demonstration."""
        write_json(self._rejected_path(seed), {"seed": seed, "reason": reason})

    def is_decided(self, seed: int) -> bool:
        """Whether a seed has an episode or a rejection."""
        return self.has_episode(seed) or self._rejected_path(seed).exists()

    def has_episode(self, seed: int) -> bool:
        """Whether a seed has an episode."""
        return self.episode_path(seed).exists()

    def reasons(self) -> dict[int, str]:
        """The reasons of the rejected seeds, by seed."""
        files = sorted((self.directory / _REJECTED).glob("seed_*.json"))
        entries = [_read_json(file, "seed", "reason") for file in files]
        return {int(entry["seed"]): str(entry["reason"]) for entry in entries}

    def finish(self, seeds: Sequence[int]) -> None:
        """Store the seeds of the complete dataset."""
        write_json(self.directory / _INDEX, {"seeds": list(seeds)})

    @property
    def seeds(self) -> list[int]:
        """The seeds of a complete dataset.

        Raises:
            DatasetError: the directory holds no dataset, an incomplete or a damaged one.
            LearningError: it holds scenes that are reserved for evaluation.
        """
        index = self.directory / _INDEX
        if not index.exists():
            expert = self.identity["expert"]  # raises an error if no dataset exists at all
            raise DatasetError(
                f"{self.directory} is not complete; run the `clutter-env collect` again that began it (expert {expert})"
            )
        seeds = _read_json(index, "seeds")["seeds"]
        if not isinstance(seeds, list) or not all(isinstance(seed, int) for seed in seeds):
            raise DatasetError(f"{index} is damaged: {seeds!r} are no seeds")
        if seeds:
            training_seeds(min(seeds), max(seeds) - min(seeds) + 1)
        return seeds

    @property
    def identity(self) -> dict[str, Any]:
        """`Job.identity` of the job for which the directory was made, and its `provenance`.

        Raises:
            DatasetError: the directory holds no dataset, or a damaged one.
        """
        if not (self.directory / _JOB).exists():
            raise DatasetError(f"{self.directory} holds no dataset of `clutter-env collect`")
        return _read_json(self.directory / _JOB, "task", "expert", "first_seed")

    @property
    def task(self) -> Task:
        """Environment in which the episodes were recorded."""
        task = self.identity["task"]
        try:
            return Task(task["env_id"], task["keywords"])
        except (KeyError, TypeError) as problem:
            raise DatasetError(f"{self.directory / _JOB} is damaged: {task!r} is no task") from problem

    def warn_if_outdated(self) -> list[str]:
        """Log the differences between the present environment and that of the episodes, and return one sentence for
        each."""
        changed = differences(self.identity.get("provenance"), self.task.provenance())
        if changed:
            _log.warning("%s: %s", self.directory, " ".join(changed))
        return changed

    def __iter__(self) -> Iterator[Episode]:
        """Episodes in the order of their seeds, read one at a time."""
        return self.checked(map(read_episode, map(self.episode_path, self.seeds)))

    def checked(self, episodes: Iterable[Episode]) -> Iterator[Episode]:
        """The same episodes. Raise `DatasetError` if an episode's seed differs from that of its name, as its scene may
        be held out."""
        task = self.task
        for seed, episode in zip(self.seeds, episodes, strict=True):
            if (episode.seed, episode.task) != (seed, task):
                there = f"seed {episode.seed} in {episode.task.to_json()}"
                raise DatasetError(f"{self.episode_path(seed)} is of {there}, not of seed {seed} in {task.to_json()}")
            yield episode

    def __len__(self) -> int:
        return len(self.seeds)

    def _rejected_path(self, seed: int) -> Path:
        return self.directory / _REJECTED / f"seed_{seed:07d}.json"


@dataclass(frozen=True)
class Shards(Dataset):
    """Complete datasets that differ in their seeds alone, joined. `owners` maps a seed to its dataset."""

    owners: Mapping[int, Dataset]

    @classmethod
    def of(cls, directories: Sequence[Path]) -> Shards:
        """The datasets in one or more directories, in any order.

        Raises:
            DatasetError: a dataset is incomplete or of another job or environment, or a seed is in two datasets.
        """
        first, *others = sorted(map(Dataset, directories), key=lambda shard: shard.seeds)
        own, made, owners = first.identity, first.identity.get("provenance"), dict.fromkeys(first.seeds, first)
        for shard in others:
            there = shard.identity
            wrong = [
                f"{name}: {there.get(name)} there, {own.get(name)} in {first.directory}."
                for name in sorted({*there, *own} - {"first_seed", "provenance"})
                if there.get(name) != own.get(name)
            ] + differences(made and there.get("provenance"), made or {})
            if twice := owners.keys() & shard.seeds:
                wrong += [f"{len(twice)} seeds, the lowest {min(twice)}, are in {owners[min(twice)].directory} too."]
            if wrong:
                raise DatasetError(f"{shard.directory} does not go with {first.directory}. {' '.join(wrong)}")
            owners |= dict.fromkeys(shard.seeds, shard)
        return cls(first.directory, owners)

    @property
    def seeds(self) -> list[int]:
        """Seeds of all datasets, in ascending order."""
        return sorted(self.owners)

    def episode_path(self, seed: int) -> Path:
        """The file of a seed's episode."""
        return self.owners[seed].episode_path(seed)


def _read_json(path: Path, *names: str) -> dict[str, Any]:
    """The JSON object in a file, with at least these entries.

    Raises:
        DatasetError: the file is missing or damaged.
    """
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError) as problem:
        raise DatasetError(f"{path} cannot be read: {problem}") from problem
    if not isinstance(content, dict) or not all(name in content for name in names):
        raise DatasetError(f"{path} is damaged: it has no {', '.join(names)}")
    return content
