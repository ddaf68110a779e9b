"""Collecting demonstrations: seeds upwards, in parallel, each kept if it replays in a fresh process."""

from __future__ import annotations

import errno
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from clutter_env.learning.demonstrations.dataset import Dataset, Job
from clutter_env.learning.demonstrations.episode import record
from clutter_env.learning.demonstrations.episode_file import write_episode
from clutter_env.learning.demonstrations.experts import make_expert
from clutter_env.learning.demonstrations.replay import replay_in_fresh_process
from clutter_env.learning.errors import CollectionError
from clutter_env.parallel.workers import WorkerDied, Workers

__all__ = ["Outcome", "collect", "demonstrate"]

MAX_DEATHS = 3
"""Times that the worker of one seed may die before the collection stops."""
PATIENCE = 30
"""Rejected seeds allowed beyond four for every episode kept; more means that something is wrong."""

_NO_SPACE = (errno.ENOSPC, errno.EDQUOT)


@dataclass(frozen=True)
class Outcome:
    """What came of a seed: the episode's file as bytes, or the reason why there is none."""

    seed: int
    content: bytes = b""
    reason: str = ""
    steps: int = 0


def demonstrate(job: Job, seed: int) -> Outcome:
    """Record one episode and replay it in a fresh process; runs in a worker.

    Raises:
        OSError: no space for a temporary file.
    """
    try:
        env = job.task.make()
        try:
            episode = record(job.task, env, make_expert(env, job.expert), seed, job.options)
        finally:
            env.close()
    except Exception as problem:
        if isinstance(problem, OSError) and problem.errno in _NO_SPACE:
            raise
        return Outcome(seed, reason=f"crashed: {type(problem).__name__}: {problem}\n{traceback.format_exc()}")
    if not episode.succeeded:
        why = episode.report.get("failure") or "the episode ended without success"
        return Outcome(seed, reason=f"no success: {why}", steps=len(episode))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "episode.hdf5"
        write_episode(path, episode)
        replayed = replay_in_fresh_process(path)
        if not (replayed.is_identical and replayed.is_success):
            return Outcome(seed, reason=f"does not replay: {replayed}", steps=len(episode))
        return Outcome(seed, path.read_bytes(), steps=len(episode))


def collect(
    job: Job, dataset: Dataset, workers: Workers[Outcome], report: Callable[[Outcome], None] = lambda _: None
) -> list[int]:
    """Demonstrate seed after seed until the dataset has all its episodes; the seeds that make it up.

    Never more seeds are under way than episodes are missing, so that none is made in vain.

    Args:
        job: what to collect.
        dataset: where to; what it has already is not made again.
        workers: run `demonstrate`.
        report: called with every outcome.

    Raises:
        CollectionError: a full disk, a worker that dies again and again, or far too many rejected seeds.
    """
    pending: set[int] = set()
    deaths: Counter[int] = Counter()
    seed = job.first_seed
    kept = rejected = 0
    while True:
        while len(pending) < workers.count and kept + len(pending) < job.episodes:
            if dataset.has_episode(seed):
                kept += 1
            elif dataset.is_decided(seed):
                rejected += 1
            else:
                workers.submit(seed)
                pending.add(seed)
            seed += 1
        if not pending:
            break
        for done, outcome in workers.wait():
            if isinstance(outcome, WorkerDied):
                deaths[done] += 1
                _give_up_on_deaths(done, deaths[done], outcome)
                workers.submit(done)
                continue
            pending.remove(done)
            _store(dataset, outcome)
            kept, rejected = kept + bool(outcome.content), rejected + (not outcome.content)
            report(outcome)
        if rejected > PATIENCE + 4 * kept:
            reasons = Counter(reason.splitlines()[0] for reason in dataset.reasons().values()).most_common(3)
            raise CollectionError(f"{rejected} seeds rejected and only {kept} kept; most often: {reasons}")
    chosen = dataset.chosen_seeds(job)
    assert chosen is not None
    dataset.finish(chosen)
    return chosen


def _store(dataset: Dataset, outcome: Outcome) -> None:
    try:
        if outcome.content:
            dataset.put(outcome.seed, outcome.content)
        else:
            dataset.reject(outcome.seed, outcome.reason)
    except OSError as problem:
        raise CollectionError(
            f"seed {outcome.seed} could not be stored in {dataset.directory}: {problem.strerror}; every episode stored "
            "before is whole; make room and run the same command again"
        ) from problem


def _give_up_on_deaths(seed: int, count: int, death: WorkerDied) -> None:
    if death.is_final or count >= MAX_DEATHS:
        raise CollectionError(
            f"the worker of seed {seed} ended {count} times ({death.cause}); out of memory, or killed? Every episode "
            "stored before is whole; run the same command again to go on, with fewer --workers if memory is short"
        )
