"""Collection of demonstrations: seeds in ascending order, in parallel. An episode is kept if it replays in a new
process."""

from __future__ import annotations

import errno
import itertools
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeAlias

from clutter_env.data.dataset import Dataset, Job
from clutter_env.data.episode import record
from clutter_env.data.episode_file import write_episode
from clutter_env.data.replay import replay_in_fresh_process, with_images
from clutter_env.errors import CollectionError, LearningError
from clutter_env.parallel import Crash, Killed
from clutter_env.policies.experts import find_expert, make_expert
from clutter_env.seeds import training_seeds
from clutter_env.task import Task

MAX_DEATHS = 3
"""The collection stops after the worker of a single seed has died this many times."""
MAX_REJECTED, MAX_REJECTED_PER_KEPT = 30, 4
"""The collection stops after more than 30 rejected seeds, plus 4 for every episode kept. The task or the expert is then
probably wrong."""

_NO_SPACE = (errno.ENOSPC, errno.EDQUOT)


@dataclass(frozen=True)
class SeedResult:
    """The result of one seed: the content of the episode's file, or the reason for its rejection."""

    seed: int
    content: bytes = b""
    reason: str = ""


JobRunner: TypeAlias = Callable[
    [Callable[[int], SeedResult], Iterable[int | None]], Iterator[tuple[int, SeedResult | Crash | Killed]]
]
"""Runs `demonstrate` on seeds in parallel: `run_jobs` with a fixed number of workers."""


def make_job(task: Task, expert: str, episodes: int, first_seed: int = 0, image_size: int = 0) -> Job:
    """Make a checked job for a collection.

    Args:
        task: environment and keyword arguments.
        expert: an entry of `experts.expert_names`, "" for the first.
        episodes: desired number of successful episodes, at least 1.
        first_seed: see `training_seeds`.
        image_size: [pixels] of camera images, 0 for none.

    Raises:
        LearningError: a value is out of its range, or the task lacks a property that the expert needs.
        UnknownTask: no such environment, or not with these keyword arguments.
        UnknownExpert: no such expert for this environment. The message lists the known experts.
    """
    if episodes < 1:
        raise LearningError(f"episodes={episodes} is not valid; it must be at least 1")
    training_seeds(first_seed, episodes)
    found = find_expert(task.env_id, expert)
    with closing(task.make(**({"obs_mode": "rgbd", "image_size": image_size} if image_size else {}))) as env:
        for name, value in make_expert(found).env_keywords.items():
            if getattr(env.get_wrapper_attr("config"), name) != value:
                raise LearningError(f"{found!r} needs {name}={value!r}: --{name.replace('_', '-')} {value}")
    return Job(task, found, episodes, first_seed, image_size=image_size)


def demonstrate(job: Job, seed: int) -> SeedResult:
    """Record one episode and replay it in a new process. Only clean successes are demonstrations. Runs in a worker.

    Raises:
        OSError: no space for a temporary file.
        RenderingUnavailable: images are requested, and this machine cannot render.
    """
    try:
        with closing(job.task.make()) as env:
            episode = record(job.task, env, make_expert(job.expert), seed, job.options)
    except Exception as problem:
        if isinstance(problem, OSError) and problem.errno in _NO_SPACE:
            raise
        return SeedResult(seed, reason=f"crashed: {type(problem).__name__}: {problem}\n{traceback.format_exc()}")
    if not episode.succeeded:
        why = episode.report.get("failure") or "the episode ended without success"
        return SeedResult(seed, reason=f"no success: {why}")
    if not episode.is_clean:
        return SeedResult(seed, reason="not clean: an object has fallen or been disturbed")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "episode.hdf5"
        write_episode(path, episode)
        replayed = replay_in_fresh_process(path)
        if not (replayed.is_identical and replayed.is_success):
            return SeedResult(seed, reason=f"does not replay: {replayed}")
        if job.image_size:
            write_episode(path, with_images(episode, job.image_size))
        return SeedResult(seed, path.read_bytes())


def collect(
    job: Job, dataset: Dataset, run: JobRunner, report: Callable[[SeedResult], None] = lambda _: None
) -> list[int]:
    """Demonstrate seeds in ascending order until the dataset has all its episodes.

    At most as many seeds are in progress as episodes are missing, so that no episode is superfluous.

    Args:
        job: what to collect.
        dataset: the destination. Seeds that it has decided already are not tried again.
        run: for example `partial(run_jobs, workers=2)`.
        report: called with every result.

    Returns:
        The seeds of the dataset.

    Raises:
        CollectionError: a full disk, a worker that dies again and again, or far too many rejected seeds.
    """
    running, again, deaths = set[int](), list[int](), Counter[int]()
    count = Counter[bool]()  # whether the decided seeds have an episode
    stored = "every episode stored before is complete; run the same command again to go on"

    def to_try() -> Iterator[int | None]:
        """Undecided seeds in ascending order, or None while those in progress may suffice."""
        seed = job.first_seed
        while True:
            if again:  # their workers died
                yield again.pop()
            elif count[True] + len(running) >= job.episodes:
                if not running:
                    return
                yield None
            else:
                if dataset.is_decided(seed):
                    count[dataset.has_episode(seed)] += 1
                else:
                    training_seeds(seed)  # after many failures the seeds may reach the held-out range
                    running.add(seed)
                    yield seed
                seed += 1

    for seed, result in run(partial(demonstrate, job), to_try()):
        if isinstance(result, SeedResult):
            running.remove(seed)
            _store(dataset, result)
            count[bool(result.content)] += 1
            if count[False] > MAX_REJECTED + MAX_REJECTED_PER_KEPT * count[True]:
                reasons = Counter(reason.splitlines()[0] for reason in dataset.reasons().values()).most_common(3)
                raise CollectionError(
                    f"{count[False]} seeds rejected and only {count[True]} kept; most often: {reasons}"
                )
            report(result)
            continue
        if isinstance(result, Crash) and result.is_final:
            raise CollectionError(f"seed {seed} could not be demonstrated: {result.summary}; {stored}")
        deaths[seed] += 1
        if deaths[seed] >= MAX_DEATHS:
            raise CollectionError(
                f"the worker of seed {seed} ended {deaths[seed]} times ({result.summary}); out of memory, or killed? "
                f"{stored}, with fewer --workers if memory is short"
            )
        again.append(seed)
    chosen = list(itertools.islice(filter(dataset.has_episode, itertools.count(job.first_seed)), job.episodes))
    dataset.finish(chosen)
    return chosen


def _store(dataset: Dataset, result: SeedResult) -> None:
    try:
        if result.content:
            dataset.put(result.seed, result.content)
        else:
            dataset.reject(result.seed, result.reason)
    except OSError as problem:
        raise CollectionError(
            f"seed {result.seed} could not be stored in {dataset.directory}: {problem.strerror}; every "
            "episode stored before is complete; free some space and run the same command again"
        ) from problem
