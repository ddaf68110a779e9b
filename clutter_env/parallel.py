"""Jobs in parallel, in processes of this machine (loky) or on many machines (Ray).

If a process dies, loky raises an exception where `multiprocessing.Pool` waits for ever. Its processes can also be ended
at any time. Each of our workers is an executor of its own with one process. So a job that dies or is ended takes no
other job with it.
"""

from __future__ import annotations

import math
import os
import re
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from clutter_env.errors import ClutterEnvError, missing_extra

J = TypeVar("J")
R = TypeVar("R")

POLL_INTERVAL = 1.0
"""[s] between checks of the time limit, and between a worker's checks that its parent still runs."""


class WorkerError(ClutterEnvError):
    """Jobs cannot be started: too few workers, or Ray is not installed."""


@dataclass(frozen=True)
class Crash:
    """A job that ended without a result.

    Attributes:
        detail: the traceback, or how the process ended.
        is_final: the job itself raised an exception, so that another try would end in the same way. False if its
            process died (out of memory, killed).
    """

    detail: str
    is_final: bool = False

    @property
    def summary(self) -> str:
        """The last line of `detail`: the exception with its message, or how the process ended."""
        return self.detail.strip().rpartition("\n")[2]


@dataclass(frozen=True)
class Killed:
    """A job that ran longer than `seconds` [s] of wall time and was ended."""

    seconds: float

    @property
    def detail(self) -> str:
        """Description of the end of the job."""
        return f"killed after {self.seconds:.0f} s"

    summary = detail


def run_jobs(
    function: Callable[[J], R],
    jobs: Iterable[J | None],
    workers: int,
    limit_s: float | None = None,
    ray: str = "",
) -> Generator[tuple[J, R | Crash | Killed], None, None]:
    """Apply a function to jobs, `workers` at a time. Yield pairs of job and result in the order in which jobs end.

    The next job is taken from the iterable only when a worker is free and all results so far have been yielded. So jobs
    may depend on results. If the iterable yields None, it has no job at present. It is asked again after the next
    result, and the iteration ends if nothing is running.

    A job that raises an exception, or whose process dies, gives a `Crash`. A job that runs too long gives `Killed`. The
    other jobs continue, and a dead process is replaced. All workers end with the iterator, and with the process that
    started them.

    Args:
        function: picklable, as are jobs and results.
        jobs: arguments of the function.
        workers: number of jobs that run at a time, at least 1.
        limit_s: [s] of wall time after which a job is ended, None for no limit.
        ray: address of Ray ("auto", "local", …), empty for processes of this machine.

    Raises:
        WorkerError: fewer than one worker, or Ray is not installed.
    """
    if workers < 1:
        raise WorkerError(f"workers={workers} is not valid; it must be at least 1")
    return _results(function, iter(jobs), workers, math.inf if limit_s is None else limit_s, ray)


def _results(
    function: Callable[[J], R], waiting: Iterator[J | None], workers: int, limit_s: float, ray: str
) -> Generator[tuple[J, R | Crash | Killed], None, None]:
    backend = _RayTasks(workers, ray) if ray else _LocalProcesses()
    running: dict[Future[Any], tuple[J, float]] = {}
    try:
        while True:
            while len(running) < workers and (job := next(waiting, None)) is not None:
                running[backend.submit(function, job)] = job, time.monotonic() + limit_s
            if not running:
                return
            wait(running, POLL_INTERVAL if limit_s < math.inf else None, FIRST_COMPLETED)
            for future, (job, deadline) in list(running.items()):
                result: R | Crash | Killed
                if future.done():
                    result = backend.result(future)
                elif time.monotonic() > deadline:
                    backend.end(future)
                    result = Killed(limit_s)
                else:
                    continue
                del running[future]
                yield job, result
    finally:
        backend.close()


def _call(function: Callable[[Any], Any], job: Any) -> Any:
    """Apply the function in a worker. An exception is returned as text, because not every exception can be pickled."""
    try:
        return function(job)
    except Exception:
        return Crash(traceback.format_exc(), is_final=True)


class _LocalProcesses:
    """Executors of one process each, started when first needed and kept for later jobs.

    As in `_RayTasks`, `result` of a finished future may be a `Crash`, `end` ends a running job and its process, and
    `close` ends all of them.
    """

    def __init__(self) -> None:
        self._idle: list[Any] = []
        self._busy: dict[Future[Any], Any] = {}

    def submit(self, function: Callable[[Any], Any], job: Any) -> Future[Any]:
        from loky import ProcessPoolExecutor
        from loky.backend import get_context

        with _ctrl_c_left_to_this_process():
            if self._idle:
                executor = self._idle.pop()
            else:
                # As with "spawn" of the standard library, the worker imports the main module, which may define jobs.
                context, own = get_context("loky_init_main"), os.getpid()
                executor = ProcessPoolExecutor(1, context=context, initializer=_begin_worker, initargs=(own,))
            future: Future[Any] = executor.submit(_call, function, job)
            self._busy[future] = executor
        return future

    def result(self, future: Future[Any]) -> Any:
        executor = self._busy.pop(future)
        try:
            result = future.result()
        except Exception as problem:  # an exception of loky's, about the process or about pickling
            executor.shutdown(wait=False, kill_workers=True)
            ended = re.search(r"exit codes of the workers are \{(.*?)\}", str(problem))
            return Crash(f"the process ended: {ended[1]}" if ended else repr(problem))
        self._idle.append(executor)
        return result

    def end(self, future: Future[Any]) -> None:
        self._busy.pop(future).shutdown(wait=False, kill_workers=True)

    def close(self) -> None:
        for executor in (*self._idle, *self._busy.values()):
            executor.shutdown(wait=True, kill_workers=True)  # otherwise loky may still be cleaning up when Python ends


@contextmanager
def _ctrl_c_left_to_this_process() -> Iterator[None]:
    """Block Ctrl-C for a moment. Processes started in it never get it, and this process gets it afterwards.

    Processes inherit the blocked signal. In this process any other thread takes it, such as that of a progress bar, and
    Python would still raise KeyboardInterrupt here. Therefore it is kept for later.
    """
    if not hasattr(signal, "pthread_sigmask") or threading.current_thread() is not threading.main_thread():
        yield
        return
    from multiprocessing import resource_tracker

    from loky.backend import resource_tracker as loky_tracker

    for tracker in (resource_tracker, loky_tracker):  # their own start would unblock Ctrl-C
        tracker.ensure_running()
    held: list[int] = []
    handler = signal.signal(signal.SIGINT, lambda number, _: held.append(number))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        signal.signal(signal.SIGINT, handler or signal.SIG_DFL)
    if held:
        signal.raise_signal(signal.SIGINT)


def _begin_worker(parent: int) -> None:
    """Make a worker end exactly when its parent does, so that a killed command leaves no workers.

    loky would restart a worker, with a warning, whose memory has grown by 300 MB since its first job. It regards
    planners and networks that are kept for later jobs as a leak.
    """
    from loky import process_executor

    process_executor._MAX_MEMORY_LEAK_SIZE = sys.maxsize

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(POLL_INTERVAL)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class _RayTasks:
    """One Ray task with one CPU for each job. "local" starts Ray with as many CPUs as workers."""

    def __init__(self, workers: int, address: str) -> None:
        try:
            import ray  # an optional dependency
        except ModuleNotFoundError as problem:
            raise WorkerError(missing_extra(problem) or str(problem)) from problem
        self._ray = ray
        self._is_ours = not ray.is_initialized()
        if self._is_ours:
            here = {"num_cpus": workers} if address == "local" else {}
            ray.init(address=address, include_dashboard=False, log_to_driver=False, **here)
        self._task = ray.remote(num_cpus=1, max_retries=0)(_call)
        self._references: dict[Future[Any], Any] = {}

    def submit(self, function: Callable[[Any], Any], job: Any) -> Future[Any]:
        reference = self._task.remote(function, job)
        future: Future[Any] = reference.future()
        self._references[future] = reference
        return future

    def result(self, future: Future[Any]) -> Any:
        del self._references[future]
        try:
            return future.result()
        except self._ray.exceptions.RayError as problem:
            return Crash(str(problem))

    def end(self, future: Future[Any]) -> None:
        self._ray.cancel(self._references.pop(future), force=True)

    def close(self) -> None:
        for reference in self._references.values():
            self._ray.cancel(reference, force=True)
        if self._is_ours:
            self._ray.shutdown()
