"""What a job without a result leaves, and the protocol of the places where jobs run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

__all__ = ["Backend", "Crash", "Killed"]

J = TypeVar("J")
R = TypeVar("R")


@dataclass(frozen=True)
class Crash:
    """The job ended without a result.

    Attributes:
        detail: the traceback, or how the process ended.
        is_final: the job itself raised an exception, so that another try would end in the same way; False if its
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
    """The job ran longer than `seconds` [s] of wall time and was ended."""

    seconds: float


class Backend(Protocol[J, R]):
    """Runs one function on jobs, several at a time."""

    def submit(self, job: J) -> None:
        """Start a job; the caller keeps the number of running jobs within the number of workers."""
        ...

    def wait(self) -> list[tuple[J, R | Crash | Killed]]:
        """Wait until at least one running job has ended; the jobs that have, with their results."""
        ...

    def close(self) -> None:
        """End all workers, also those that are still running a job."""
        ...
