"""Training: one directory per run, with all that is needed to resume it, or to act with its policy."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from clutter_env.errors import LearningError
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.training.run import Run
from clutter_env.training.settings import BC, Keyframes, Reinforcement, Settings

History = list[dict[str, float]]


@dataclass(frozen=True)
class Trained:
    """A run that has ended: its history (success on held-out scenes), wall time [s] and CPU time [s]."""

    history: History
    wall_s: float
    cpu_s: float


def train(run: Run, resume: bool = False) -> Trained:
    """Train in this process.

    Args:
        run: what to train.
        resume: go on from the last checkpoint, if there is one, until `run.settings.steps` in all.

    Raises:
        LearningError: see `Run.check`; nothing is written then. Or the disk is full or cannot be written; the last
            complete checkpoint stays.
        PolicyError: the checkpoint from which to go on is damaged, or of version 0.1.
    """
    started, started_cpu = time.perf_counter(), time.process_time()
    run.check(resume)
    try:
        run.write_record()
        learn = _learner(run.settings, resume)
        history = learn(run)
    except OSError as problem:
        raise LearningError(
            f"training had to stop: {problem}; the last complete checkpoint in {run.directory} stays, and --resume "
            "goes on from there"
        ) from problem
    return Trained(history, time.perf_counter() - started, time.process_time() - started_cpu)


def _learner(settings: Settings, resume: bool) -> Callable[[Run], History]:
    """The function that trains a run of an algorithm; it is imported here, since all of them need torch."""
    import torch

    # The networks are small: more threads are slower, and several runs share a machine.
    torch.set_num_threads(1)
    match settings:
        case Reinforcement():
            from clutter_env.training.reinforcement import reinforce

            return partial(reinforce, resume=resume)
        case BC():
            from clutter_env.training.cloning import train_clone

            return train_clone
        case Keyframes():
            from clutter_env.training.motions import train_motions

            return train_motions
    from clutter_env.training.high_level import train_decisions

    return train_decisions


def train_all(
    runs: Sequence[Run],
    workers: int,
    resume: bool = False,
    ray: str = "",
    report: Callable[[Run, Trained], None] = lambda *_: None,
) -> list[Trained]:
    """Train all runs: one in this process, several in parallel.

    Args:
        runs: each with its own directory; all are checked before the first one starts.
        workers: how many are trained at a time.
        resume: go on from their last checkpoints.
        ray: address of Ray; empty for processes of this machine.
        report: called with each run as it ends.

    Raises:
        LearningError: see `Run.check`; or runs crashed, after the others have ended.
    """
    for run in runs:
        run.check(resume)
    if len(runs) == 1:
        only = train(runs[0], resume)
        report(runs[0], only)
        return [only]
    trained, crashed = {}, []
    for run, result in run_jobs(partial(train, resume=resume), runs, workers, ray=ray):
        if isinstance(result, Crash | Killed):
            crashed.append(f"{run.directory}: {result.detail if isinstance(result, Crash) else result}")
        else:
            trained[run.directory] = result
            report(run, result)
    if crashed:
        raise LearningError("; ".join(crashed))
    return [trained[run.directory] for run in runs]
