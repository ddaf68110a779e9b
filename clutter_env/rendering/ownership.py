"""Who may use OpenGL: the process that opened it, and a context only in the thread that made it.

A forked process has a copy of the OpenGL driver's memory without its threads, and hangs in its first call.
"""

from __future__ import annotations

import os
import threading

from clutter_env.errors import RenderingUnavailable

__all__ = ["ContextOwner", "check_no_fork", "note_opened"]

_opened_by: set[int] = set()
"""Processes that have opened OpenGL: this one, or those from which it was forked."""


def check_no_fork() -> None:
    """Make sure that this process may open OpenGL.

    Raises:
        RenderingUnavailable: it was forked from a process that had opened OpenGL.
    """
    if _opened_by - {os.getpid()}:
        raise RenderingUnavailable(
            "this process was forked from one that had rendered, and OpenGL does not survive a fork; start worker "
            "processes by spawning: gym.make_vec(..., vectorization_mode='async', vector_kwargs={'context': 'spawn'}), "
            "AsyncVectorEnv(..., context='spawn'), multiprocessing.get_context('spawn')"
        )


def note_opened() -> None:
    """Remember that this process opens OpenGL."""
    _opened_by.add(os.getpid())


class ContextOwner:
    """The process and the thread that made an OpenGL context."""

    def __init__(self) -> None:
        self._process, self._thread = os.getpid(), threading.get_ident()

    @property
    def is_this_process(self) -> bool:
        """Whether the context was made in this process, and not in one from which it was forked."""
        return self._process == os.getpid()

    def check(self) -> None:
        """Make sure that the context may be used here.

        Raises:
            RenderingUnavailable: it was made in another process or in another thread.
        """
        if not self.is_this_process:
            check_no_fork()
        if self._thread != threading.get_ident():
            raise RenderingUnavailable(
                "this environment has rendered in another thread, and an OpenGL context belongs to its thread; render "
                "and close in one thread, or make one environment for each thread"
            )
