"""Jobs in processes of this machine that may crash or hang: a process that dies is replaced, the others go on."""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

from clutter_env.parallel.result import Crash, Killed

__all__ = ["LocalProcesses"]

J = TypeVar("J")
R = TypeVar("R")

POLL_INTERVAL = 1.0
"""[s] between checks of the time limit, and between a worker's checks that its parent still runs."""


@dataclass(frozen=True)
class _Worker:
    process: BaseProcess
    pipe: Connection


@dataclass(frozen=True)
class _Running(Generic[J]):
    worker: _Worker
    job: J
    deadline: float


class LocalProcesses(Generic[J, R]):
    """Spawned processes, each started when it is first needed and kept for later jobs.

    Args:
        function: importable by name in a new process, as are jobs and results.
        limit_s: [s] of wall time after which a job is ended, with its process.
    """

    def __init__(self, function: Callable[[J], R], limit_s: float) -> None:
        self._function, self._limit_s = function, limit_s
        self._running: list[_Running[J]] = []
        self._idle: list[_Worker] = []

    def submit(self, job: J) -> None:
        """Start a job in an idle process, or in a new one."""
        worker = self._idle_worker()
        worker.pipe.send(job)
        self._running.append(_Running(worker, job, time.monotonic() + self._limit_s))

    def wait(self) -> list[tuple[J, R | Crash | Killed]]:
        """Wait until at least one running job has ended; the jobs that have, with their results."""
        ended: list[tuple[J, R | Crash | Killed]] = []
        while not ended:
            wait([entry.worker.pipe for entry in self._running], timeout=POLL_INTERVAL)
            for entry in list(self._running):
                result = _result(entry, self._limit_s)
                if result is None:
                    continue
                self._running.remove(entry)
                if entry.worker.process.is_alive():
                    self._idle.append(entry.worker)
                else:
                    entry.worker.pipe.close()
                ended.append((entry.job, result[0]))
        return ended

    def close(self) -> None:
        """End all processes."""
        for worker in [*self._idle, *(entry.worker for entry in self._running)]:
            worker.pipe.close()
            worker.process.terminate()
        self._idle.clear()
        self._running.clear()

    def _idle_worker(self) -> _Worker:
        while self._idle:
            worker = self._idle.pop()
            if worker.process.is_alive():
                return worker
            worker.pipe.close()
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(self._function, theirs, os.getpid()), daemon=True)
        process.start()
        theirs.close()
        return _Worker(process, ours)


def _serve(function: Callable[[Any], Any], pipe: Connection, parent: int) -> None:
    """The loop of a worker: receive a job, send its result, until the pipe is closed or the parent has ended."""
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    while True:
        try:
            job = pipe.recv()
        except (EOFError, ConnectionError):
            return
        try:
            result = function(job)
        except Exception:  # whatever a job raises is a result to report
            result = Crash(traceback.format_exc(), is_final=True)
        try:
            pipe.send(result)
        except ConnectionError:
            return


def _end_with(parent: int) -> None:
    """End this process when its parent has: a killed command leaves no workers behind."""
    while os.getppid() == parent:
        time.sleep(POLL_INTERVAL)
    os._exit(1)


def _result(entry: _Running[Any], limit_s: float) -> tuple[Any] | None:
    """The result of a running job in a tuple, or None while it runs."""
    process, pipe = entry.worker.process, entry.worker.pipe
    if pipe.poll():
        try:
            return (pipe.recv(),)
        except (EOFError, ConnectionError):
            process.join()
            return (Crash(f"the process ended with exit code {process.exitcode}"),)
    if time.monotonic() > entry.deadline:
        process.kill()
        process.join()
        return (Killed(limit_s),)
    return None
