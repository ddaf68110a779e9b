"""The pool of workers: jobs that crash, hang or wait for results; workers that die, and parents that do."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from clutter_env.parallel import Crash, Killed, WorkerError, run_jobs

ROOT = Path(__file__).resolve().parents[2]
KEPT: list[bytes] = []
"""In a worker: what it has loaded."""


@pytest.fixture(params=["", pytest.param("local", marks=pytest.mark.slow)], ids=["processes", "ray"])
def ray(request: pytest.FixtureRequest) -> str:
    """Address of Ray: "" for processes."""
    if request.param:
        pytest.importorskip("ray")
    return str(request.param)


def behave(how: str) -> str:
    """A job that does what it is told."""
    if how == "raise":
        raise RuntimeError("as told")
    if how == "full":
        raise OSError(28, "No space left on device")
    if how == "die":
        os._exit(3)
    if how == "hang":
        time.sleep(60)
    return how


def add(first: int, second: int) -> int:
    return first + second


def test_jobs_that_crash_or_hang_do_not_stop_the_others(ray: str) -> None:
    jobs = ["one", "raise", "full", "die", "hang", "two"]
    results = dict(run_jobs(behave, jobs, workers=2, limit_s=8.0, ray=ray))
    assert (results["one"], results["two"]) == ("one", "two")
    assert isinstance(results["raise"], Crash)
    assert "RuntimeError: as told" in results["raise"].detail
    assert results["raise"].is_final
    assert isinstance(results["full"], Crash)
    assert results["full"].is_final
    assert "No space left on device" in results["full"].summary
    assert isinstance(results["die"], Crash)
    assert not results["die"].is_final
    assert results["hang"] == Killed(8.0)


def test_how_a_process_ended_is_said_and_one_worker_is_replaced() -> None:
    assert list(run_jobs(behave, ["die", "one"], workers=1)) == [
        ("die", Crash("the process ended: EXIT(3)")),
        ("one", "one"),
    ]


def test_partial_functions_are_run(ray: str) -> None:
    assert sorted(run_jobs(partial(add, 10), range(3), workers=2, ray=ray)) == [(0, 10), (1, 11), (2, 12)]


def test_jobs_may_depend_on_results() -> None:
    """None makes the pool wait for a result; the jobs go on behind it."""
    results: list[int] = []

    def jobs() -> Iterator[int | None]:
        for _ in range(3):
            count = len(results)
            yield count
            while len(results) == count:
                yield None

    for _, result in run_jobs(partial(add, 1), jobs(), workers=2):
        assert isinstance(result, int)
        results.append(result)
    assert results == [1, 2, 3]


def test_none_with_nothing_running_ends_the_jobs() -> None:
    assert list(run_jobs(partial(add, 1), [None, 1], workers=2)) == []


def test_too_few_workers_are_refused() -> None:
    with pytest.raises(WorkerError, match="workers=0"):
        run_jobs(behave, [], workers=0)


def test_ray_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(WorkerError, match=r"clutter-env\[distributed\]"):
        list(run_jobs(behave, ["one"], workers=1, ray="local"))


def test_workers_end_with_the_iterator() -> None:
    results = run_jobs(behave, ["one", "hang"], workers=2)
    assert next(results) == ("one", "one")
    results.close()
    assert not multiprocessing.active_children()


def load(megabytes: int) -> int:
    """Keep so much in memory, as a planner or a network that is loaded for later jobs; the process."""
    KEPT.append(os.urandom(megabytes * 2**20))
    time.sleep(1.1)  # loky looks once a second
    return os.getpid()


def test_what_a_worker_loads_for_later_jobs_is_no_leak(monkeypatch: pytest.MonkeyPatch) -> None:
    """loky starts a worker anew, with a warning, that has grown by 300 MB since its first job."""
    monkeypatch.setenv("LOKY_MAX_MEMORY_LEAK_SIZE", str(10 * 2**20))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        processes = [process for _, process in run_jobs(load, [1, 30, 1], workers=1)]
    assert len(set(processes)) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pgrep in any case")
def test_workers_end_where_no_pgrep_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without psutil loky asks `pgrep` which processes to end, and small containers have none."""
    program, called = tmp_path / "pgrep", tmp_path / "called"
    program.write_text(f"#!/bin/sh\necho called >{called}\nexit 127\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    results = run_jobs(behave, ["one", "hang"], workers=2)
    assert next(results) == ("one", "one")
    results.close()
    assert not multiprocessing.active_children()
    assert not called.exists()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no signals to hold back")
def test_a_worker_that_is_being_started_is_started_and_ended_when_ctrl_c_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any other thread, such as the one of a progress bar, takes a Ctrl-C that the main thread holds back."""
    from loky.backend import fork_exec as loky_start

    start, started, is_over = loky_start.fork_exec, [], threading.Event()

    def start_and_press_ctrl_c(*arguments: object, **keywords: object) -> int:
        pid = start(*arguments, **keywords)
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.1)
        started.append(pid)
        return pid

    monkeypatch.setattr(loky_start, "fork_exec", start_and_press_ctrl_c)
    threading.Thread(target=is_over.wait).start()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
    try:
        with pytest.raises(KeyboardInterrupt):
            list(run_jobs(behave, ["hang"], workers=1))
    finally:
        is_over.set()
        after = signal.signal(signal.SIGINT, before)
    (worker,) = started
    assert _when(lambda: not _runs(worker))
    assert after is signal.default_int_handler


PARENT = """
from clutter_env.parallel import run_jobs
from tests.clutter_env.test_parallel import announce
if __name__ == "__main__":
    list(run_jobs(announce, [{path!r}], workers=1))
"""


def announce(path: str) -> None:
    """Write down this process's id, then go on for a long time."""
    Path(path).write_text(str(os.getpid()))
    time.sleep(60)


def test_workers_end_with_a_killed_parent(tmp_path: Path) -> None:
    script, written = tmp_path / "parent.py", tmp_path / "pid"
    script.write_text(PARENT.format(path=str(written)))
    parent = subprocess.Popen([sys.executable, str(script)], env={**os.environ, "PYTHONPATH": str(ROOT)})
    worker = int(_when(lambda: written.exists() and written.read_text()))
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    assert _when(lambda: not _runs(worker))


def _when(condition) -> object:
    """The value of a condition once it is true, or its last value after 30 s."""
    deadline = time.monotonic() + 30
    while not (value := condition()) and time.monotonic() < deadline:
        time.sleep(0.05)
    return value


def _runs(process: int) -> bool:
    """Whether a process runs; one that has ended and waits to be collected does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
