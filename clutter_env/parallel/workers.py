"""Where work is done: processes of this machine, or Ray. The results are the same."""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from clutter_env.parallel.errors import WorkerError

__all__ = ["LocalWorkers", "RayWorkers", "WorkerDied", "Workers"]

R = TypeVar("R")
WATCH_INTERVAL = 1.0
"""[s] between a worker's looks whether its parent still lives."""


@dataclass(frozen=True)
class WorkerDied:
    """The process that worked on a seed ended, or could not go on; `is_final` if trying again is no use."""

    cause: str
    is_final: bool = False


class Workers(Protocol[R]):
    """Apply a function to seeds, several at a time."""

    @property
    def count(self) -> int:
        """How many at a time."""
        ...

    def submit(self, seed: int) -> None:
        """Begin with a seed."""
        ...

    def wait(self) -> list[tuple[int, R | WorkerDied]]:
        """Wait until one is done; those that are."""
        ...

    def close(self) -> None:
        """Stop everything."""
        ...


class LocalWorkers(Generic[R]):
    """Processes of this machine, each started afresh; a process that dies is replaced."""

    def __init__(self, function: Callable[[Any, int], R], argument: Any, count: int) -> None:
        if count < 1:
            raise WorkerError(f"workers={count} is not valid; it must be at least 1")
        self._function, self._argument, self.count = function, argument, count
        self._seeds: dict[Future[R], int] = {}
        self._pool = self._new_pool()

    def submit(self, seed: int) -> None:
        """Begin with a seed."""
        self._seeds[self._pool.submit(self._function, self._argument, seed)] = seed

    def wait(self) -> list[tuple[int, R | WorkerDied]]:
        """Wait until one is done; those that are."""
        finished, _ = wait(self._seeds, return_when=FIRST_COMPLETED)
        results: list[tuple[int, R | WorkerDied]] = [(self._seeds.pop(done), _result(done)) for done in finished]
        if any(isinstance(result, WorkerDied) and not result.is_final for _, result in results):
            results += [(seed, WorkerDied("its process ended")) for seed in self._seeds.values()]
            self._seeds.clear()
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = self._new_pool()
        return results

    def close(self) -> None:
        """Stop everything."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _new_pool(self) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self.count, context, initializer=_end_with_parent, initargs=(os.getpid(),))


class RayWorkers(Generic[R]):
    """Ray tasks; `address` as in `ray.init`: "auto", "local", or a cluster's address.

    Raises:
        WorkerError: Ray is not installed.
    """

    def __init__(self, function: Callable[[Any, int], R], argument: Any, count: int, address: str) -> None:
        try:
            import ray
        except ImportError:
            raise WorkerError("Ray is not installed; pip install 'clutter-env[distributed]'") from None
        self._ray = ray
        self._is_ours = not ray.is_initialized()
        if self._is_ours:
            here = {"num_cpus": count} if address == "local" else {}
            ray.init(address=address, include_dashboard=False, log_to_driver=False, **here)
        self.count = count
        self._function = ray.remote(num_cpus=1, max_retries=0)(function)
        self._argument = argument
        self._seeds: dict[Any, int] = {}

    def submit(self, seed: int) -> None:
        """Begin with a seed."""
        self._seeds[self._function.remote(self._argument, seed)] = seed

    def wait(self) -> list[tuple[int, R | WorkerDied]]:
        """Wait until one is done; those that are."""
        finished, _ = self._ray.wait(list(self._seeds), num_returns=1)
        return [(self._seeds.pop(reference), self._get(reference)) for reference in finished]

    def close(self) -> None:
        """Stop everything."""
        if self._is_ours:
            self._ray.shutdown()

    def _get(self, reference: Any) -> R | WorkerDied:
        try:
            return self._ray.get(reference)
        except self._ray.exceptions.RayTaskError as problem:
            return WorkerDied(str(problem.cause), is_final=True)
        except self._ray.exceptions.RayError as problem:
            return WorkerDied(str(problem))


def _result(future: Future[Any]) -> Any:
    """The result, or a `WorkerDied`."""
    try:
        return future.result()
    except BrokenProcessPool:
        return WorkerDied("its process ended")
    except OSError as problem:
        return WorkerDied(f"{problem.strerror or problem}", is_final=True)


def _end_with_parent(parent: int) -> None:
    """End this worker when the process that started it is gone: a killed collection leaves nothing running."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_INTERVAL)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
