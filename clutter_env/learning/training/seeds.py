"""Several training runs in parallel, such as one per seed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from clutter_env.learning.errors import LearningError
from clutter_env.learning.training.run import Run
from clutter_env.learning.training.training import Trained, train
from clutter_env.parallel import Crash, Killed, run_jobs

__all__ = ["seeds_of", "train_all"]


def seeds_of(run: Run, count: int) -> list[Run]:
    """The run with `count` seeds from its own on, each in seed-N/ in its directory; only the run itself for one seed.

    Raises:
        LearningError: fewer than one seed.
    """
    if count < 1:
        raise LearningError(f"seeds={count} is not valid; it must be at least 1")
    if count == 1:
        return [run]
    return [
        replace(run, seed=seed, directory=run.directory / f"seed-{seed}") for seed in range(run.seed, run.seed + count)
    ]


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
