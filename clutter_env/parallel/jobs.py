"""Run a function on many jobs in parallel: in processes of this machine, or on Ray."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from clutter_env.parallel.errors import WorkerError
from clutter_env.parallel.local import LocalProcesses
from clutter_env.parallel.ray_tasks import RayTasks
from clutter_env.parallel.result import Backend, Crash, Killed

__all__ = ["Crash", "Killed", "run_jobs"]

J = TypeVar("J")
R = TypeVar("R")


def run_jobs(
    function: Callable[[J], R],
    jobs: Iterable[J | None],
    workers: int,
    limit_s: float | None = None,
    ray: str = "",
) -> Iterator[tuple[J, R | Crash | Killed]]:
    """Apply a function to jobs, `workers` at a time; pairs of job and result in the order in which jobs end.

    The next job is taken from the iterable only when a worker is free and all results so far have been yielded, so
    that jobs may depend on results. A job that is None says that there is none at present: the iterable is asked again
    after the next result, and the iteration ends if nothing is running.

    A job that raises, or whose process dies, gives a `Crash`; one that runs too long gives `Killed`. The other jobs go
    on, and a process that died is replaced. All workers end with the iterator, and with the process that started them.

    Args:
        function: importable by name in a new process.
        jobs: picklable, as are the results.
        workers: how many jobs run at a time, at least 1.
        limit_s: [s] of wall time after which a job is ended; None for no limit.
        ray: address of Ray ("auto", "local", …); empty for processes of this machine.

    Raises:
        WorkerError: fewer than one worker; or Ray is not installed.
    """
    if workers < 1:
        raise WorkerError(f"workers={workers} is not valid; it must be at least 1")
    limit = math.inf if limit_s is None else limit_s

    def start() -> Backend[J, R]:
        """The place where the jobs run."""
        return RayTasks(function, limit, workers, ray) if ray else LocalProcesses(function, limit)

    return _results(start, iter(jobs), workers)


def _results(
    start: Callable[[], Backend[J, R]], waiting: Iterator[J | None], workers: int
) -> Iterator[tuple[J, R | Crash | Killed]]:
    backend = start()
    running = 0
    try:
        while True:
            while running < workers and (job := next(waiting, None)) is not None:
                backend.submit(job)
                running += 1
            if not running:
                return
            for job, result in backend.wait():
                running -= 1
                yield job, result
    finally:
        backend.close()
