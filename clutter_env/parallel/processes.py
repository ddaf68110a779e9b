"""Jobs in parallel processes that may crash or hang: whatever happens to one, the others go on."""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

__all__ = ["Crash", "Killed", "run_jobs"]

J = TypeVar("J")
R = TypeVar("R")

_LOOK = 1.0
"""[s] between looks at the clock."""


@dataclass(frozen=True)
class Crash:
    """The job raised, or its process died: the traceback, or how the process ended."""

    detail: str


@dataclass(frozen=True)
class Killed:
    """The job had to be ended after so many seconds."""

    seconds: float


@dataclass
class _Worker(Generic[J]):
    process: BaseProcess
    pipe: Connection
    job: J
    deadline: float = field(default=0.0)


def run_jobs(
    function: Callable[[J], R], jobs: Iterable[J], count: int, limit_s: float
) -> Iterator[tuple[J, R | Crash | Killed]]:
    """Apply a function to jobs in `count` processes, started afresh; results as they come.

    Jobs are taken from the iterable only when a process is free, so that it may depend on results so far. When it is
    exhausted while others still run, it is not asked again.

    Args:
        function: importable by name in a new process.
        jobs: picklable.
        count: processes.
        limit_s: [s] of wall time after which a job is killed, with its process.
    """
    waiting = iter(jobs)
    workers: list[_Worker[J]] = []
    idle: list[tuple[BaseProcess, Connection]] = []
    try:
        while True:
            while len(workers) < count and (job := next(waiting, None)) is not None:
                process, pipe = idle.pop() if idle else _start(function)
                pipe.send(job)
                workers.append(_Worker(process, pipe, job, time.monotonic() + limit_s))
            if not workers:
                return
            wait([worker.pipe for worker in workers], timeout=_LOOK)
            for worker in list(workers):
                result = _collect(worker, limit_s)
                if result is None:
                    continue
                workers.remove(worker)
                if worker.process.is_alive():
                    idle.append((worker.process, worker.pipe))
                yield worker.job, result[0]
    finally:
        for process, pipe in [*idle, *((worker.process, worker.pipe) for worker in workers)]:
            pipe.close()
            process.terminate()


def _start(function: Callable[[Any], Any]) -> tuple[BaseProcess, Connection]:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(function, theirs, os.getpid()), daemon=True)
    process.start()
    theirs.close()
    return process, ours


def _serve(function: Callable[[Any], Any], pipe: Connection, parent: int) -> None:
    """A worker's life: jobs in, results out, until the pipe is closed or the parent is gone."""
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    while True:
        try:
            job = pipe.recv()
        except (EOFError, ConnectionError):
            return
        try:
            result = function(job)
        except Exception:  # a crash of one job is a result to report, with all there is to know about it
            result = Crash(traceback.format_exc())
        try:
            pipe.send(result)
        except ConnectionError:
            return


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_LOOK)
    os._exit(1)


def _collect(worker: _Worker[Any], limit_s: float) -> tuple[Any] | None:
    """The worker's result in a tuple, or None while it works."""
    if worker.pipe.poll():
        try:
            return (worker.pipe.recv(),)
        except (EOFError, ConnectionError):
            worker.process.join()
            return (Crash(f"the process ended with exit code {worker.process.exitcode}"),)
    if time.monotonic() > worker.deadline:
        worker.process.kill()
        worker.process.join()
        return (Killed(limit_s),)
    return None
