"""Jobs as Ray tasks: on this machine or on a cluster, with the results of local processes."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from clutter_env.parallel.errors import WorkerError
from clutter_env.parallel.result import Crash, Killed

__all__ = ["RayTasks"]

J = TypeVar("J")
R = TypeVar("R")

POLL_INTERVAL = 1.0
"""[s] between checks of the time limit."""


class RayTasks(Generic[J, R]):
    """One Ray task, which takes one CPU, for each job.

    Args:
        function: picklable by Ray, as are jobs and results.
        limit_s: [s] of wall time since its submission after which a job is ended.
        workers: CPUs of the Ray instance that the address "local" starts.
        address: as in `ray.init`: "auto", "local", or the address of a cluster.

    Raises:
        WorkerError: Ray is not installed.
    """

    def __init__(self, function: Callable[[J], R], limit_s: float, workers: int, address: str) -> None:
        try:
            import ray  # an optional dependency
        except ImportError:
            raise WorkerError("Ray is not installed; pip install 'clutter-env[distributed]'") from None
        self._ray = ray
        self._is_ours = not ray.is_initialized()
        if self._is_ours:
            here = {"num_cpus": workers} if address == "local" else {}
            ray.init(address=address, include_dashboard=False, log_to_driver=False, **here)
        self._task = ray.remote(num_cpus=1, max_retries=0)(_call)
        self._function, self._limit_s = function, limit_s
        self._running: dict[Any, tuple[J, float]] = {}

    def submit(self, job: J) -> None:
        """Start a job."""
        deadline = time.monotonic() + self._limit_s
        self._running[self._task.remote(self._function, job)] = job, deadline

    def wait(self) -> list[tuple[J, R | Crash | Killed]]:
        """Wait until at least one running job has ended; the jobs that have, with their results."""
        ended: list[tuple[J, R | Crash | Killed]] = []
        while not ended:
            references = list(self._running)
            finished, _ = self._ray.wait(references, num_returns=len(references), timeout=0)
            if not finished:
                finished, _ = self._ray.wait(references, num_returns=1, timeout=POLL_INTERVAL)
            for reference in finished:
                job, _ = self._running.pop(reference)
                ended.append((job, self._result(reference)))
            for reference, (job, deadline) in list(self._running.items()):
                if time.monotonic() > deadline:
                    self._ray.cancel(reference, force=True)
                    del self._running[reference]
                    ended.append((job, Killed(self._limit_s)))
        return ended

    def close(self) -> None:
        """Cancel the running jobs; end Ray where it was started here."""
        for reference in self._running:
            self._ray.cancel(reference, force=True)
        self._running.clear()
        if self._is_ours:
            self._ray.shutdown()

    def _result(self, reference: Any) -> R | Crash:
        try:
            return self._ray.get(reference)
        except self._ray.exceptions.RayTaskError as problem:
            return Crash(str(problem), is_final=True)
        except self._ray.exceptions.RayError as problem:
            return Crash(str(problem))


def _call(function: Callable[[Any], Any], job: Any) -> Any:
    """What a task runs; Ray makes tasks of plain functions only, not of `functools.partial` objects."""
    return function(job)
