"""Loading and compiling: before a solve, not inside it, and no longer than its time limit."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from numba.core import event

from assets.robots import FETCH
from planners import Cause, Infeasible, Planner, Solution, solve, warming
from planners.clock import Deadline
from tests.planners.scenes import cylinder, table_scene

FREE = table_scene(cylinder("object_00", 0.0, 0.0))


LOADED_BY_SOLVES = """
import gc
import numpy as np
from numba.core.dispatcher import Dispatcher
from assets.robots import FETCH
from planners import Planner, warmup
from clutter_env.simulation.end_effector import TcpFollower
from tests.planners.scenes import random_scene

def loaded():
    kernels = [d for d in gc.get_objects() if isinstance(d, Dispatcher) and d.py_func.__module__.startswith("planners")]
    return {(d.py_func.__qualname__, str(s)) for d in kernels for s in d.overloads}

warmup()
before = loaded()
assert before
scene = random_scene(20, 0)
for planner in (Planner(FETCH), Planner(FETCH, follower=TcpFollower(FETCH))):
    for name in scene.names[:5]:
        for strategy in ("lookahead", "srivastava"):
            planner.solve(scene, name, strategy, time_limit=5.0)
print(*(name for name, _ in loaded() - before))
"""


@pytest.mark.slow
def test_a_warmed_up_process_loads_and_compiles_nothing_in_a_solve() -> None:
    done = subprocess.run([sys.executable, "-c", LOADED_BY_SOLVES], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


SIGNATURES = """
import gc
from numba.core.dispatcher import Dispatcher
from planners import warmup

warmup()
kernels = [d for d in gc.get_objects() if isinstance(d, Dispatcher) and d.py_func.__module__.split(".")[0] != "numba"]
assert len(kernels) > 100
print(*(f"{d.py_func.__module__}.{d.py_func.__qualname__}" for d in kernels if len(d.overloads) > 1))
"""


@pytest.mark.slow
def test_every_kernel_is_compiled_for_one_signature(tmp_path: Path) -> None:
    """14 kernels had two to four: for constants, for read-only and other arrays. Each was compiled as often.

    Nothing is compiled before: what kernels call is not loaded from the disk with them.
    """
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", SIGNATURES]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_warming_up_again_is_cheap_and_silent(caplog: pytest.LogCaptureFixture) -> None:
    planner = Planner(FETCH)
    planner.warmup()
    spent_s = []
    for _ in range(100):
        before = time.perf_counter()
        planner.warmup()
        spent_s.append(time.perf_counter() - before)
    assert min(spent_s) < 0.001, "one of a hundred is not interrupted by another process"
    assert not caplog.records


def test_whoever_waits_for_compilation_is_told_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(warming, "_warm", set())

    def compile_two(*_: object) -> None:
        for _ in range(2):
            with event.trigger_event("numba:compile"):
                pass

    with caplog.at_level(logging.WARNING):
        warming.warm_once(FETCH, None, compile_two)
    assert [record.message for record in caplog.records] == [
        "compiling the planner's kernels, once per machine (about a minute)"
    ]


def test_a_solve_ends_at_its_time_limit_while_kernels_are_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    """A new process took 2.8 s for a solve with a limit of 0.01 s: loading the kernels did not count."""
    monkeypatch.setattr(warming, "_warm", set())
    may_end, calls = threading.Event(), []

    def load(*arguments: object) -> None:
        calls.append(arguments)
        may_end.wait()

    monkeypatch.setattr(Planner, "_exercise", load)
    found = solve(FREE, "object_00", time_limit=0.01)
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.TIME_LIMIT
    assert "warmup()" in found.detail
    may_end.set()
    assert isinstance(solve(FREE, "object_00", time_limit=60.0), Solution)
    assert len(calls) == 1, "the second solve waits for what the first one began"


def test_what_fails_while_kernels_are_loaded_is_raised_in_the_solve(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(warming, "_warm", set())
    monkeypatch.setattr(Planner, "_exercise", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        solve(FREE, "object_00", time_limit=60.0)


def test_compilation_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiling takes longer than the time limit, and one kernel is compiled inside another one."""
    monkeypatch.setattr(warming, "_warm", set())

    def compile_one(_scene: object, _target: str) -> None:
        with event.trigger_event("numba:compile"), event.trigger_event("numba:compile"):
            time.sleep(1.2)

    deadline = Deadline.after(1.0)
    later = warming.warm_once(FETCH, None, compile_one, deadline)
    assert deadline.is_over
    assert later.at - deadline.at >= 1.2
    assert warming._warm, "it waited until all was loaded"


def test_compilation_does_not_count_before_the_wait_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread compiles already while the caller is still busy with starting it."""
    monkeypatch.setattr(warming, "_warm", set())

    class SlowToReturn(ThreadPoolExecutor):
        def shutdown(self, *arguments: Any, **keywords: Any) -> None:
            time.sleep(0.2)
            super().shutdown(*arguments, **keywords)

    def compile_one(_scene: object, _target: str) -> None:
        with event.trigger_event("numba:compile"):
            time.sleep(0.4)

    monkeypatch.setattr(warming, "ThreadPoolExecutor", SlowToReturn)
    deadline = Deadline.after(5.0)
    later = warming.warm_once(FETCH, None, compile_one, deadline)
    assert later.at - deadline.at >= 0.4


COLD_SOLVE = """
from planners import Solution, solve
from tests.planners.scenes import cylinder, table_scene

found = solve(table_scene(cylinder("object_00", 0.0, 0.0)), "object_00", time_limit=10.0)
assert isinstance(found, Solution), found
assert found.stats.total_s < 10.0
"""


@pytest.mark.slow
def test_on_a_cold_kernel_cache_compiling_does_not_count(tmp_path: Path) -> None:
    """Compiling takes minutes, the solve after it less than its limit of 10 s."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", COLD_SOLVE]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("compiling the planner's kernels") == 1
