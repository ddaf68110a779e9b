"""Environments in another process: answers, what they raise, and their end."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from clutter_env.bridges.remote import WORKERS, BridgeError, Remote

WORKER = """
import sys
print("what is printed is no answer")

class Worker:
    def double(self, number):
        print("nor is this")
        return {"twice": 2 * number}

    def fail(self):
        raise ValueError("no")

    def leave(self):
        print("on the way out", file=sys.stderr)
        sys.exit(3)
"""

KINDER = """
def register_all_environments(): pass

class make:
    def __init__(self, id): pass
    def reset(self, seed): raise ValueError("there is no such table")
"""


@pytest.fixture
def worker(tmp_path: Path) -> str:
    file = tmp_path / "worker.py"
    file.write_text(WORKER)
    return str(file)


def test_calls_are_answered_and_errors_are_told(worker: str) -> None:
    with Remote(sys.executable, worker) as remote:
        assert remote("double", number=0.1) == {"twice": 0.2}
        with pytest.raises(BridgeError, match="ValueError: no"):
            remote("fail")
        assert remote("double", number=3) == {"twice": 6}
        with pytest.raises(BridgeError, match=r"(?s)ended with code 3:.*on the way out"):
            remote("leave")


def test_the_traceback_of_a_worker_that_crashes_reaches_the_user(worker: str) -> None:
    Path(worker).write_text("regions = {}\nregions['near the bowl']\n")
    with (
        Remote(sys.executable, worker) as remote,
        pytest.raises(BridgeError, match="KeyError: 'near the bowl'") as told,
    ):
        remote("double", number=1)
    assert 'worker.py", line 2' in str(told.value)


def test_what_an_environment_of_kinder_raises_comes_with_its_traceback(tmp_path: Path) -> None:
    """KinDER itself is not needed: what stands in its place has one environment, which cannot be reset."""
    (tmp_path / "kinder.py").write_text(KINDER)
    for name in ("mujoco", "numpy"):
        (tmp_path / f"{name}.py").touch()
    starter = tmp_path / "starter.py"
    starter.write_text(
        f"import runpy, sys\nsys.path.insert(0, {str(tmp_path)!r})\n"
        f"Worker = runpy.run_path({str(WORKERS / 'kinder_worker.py')!r})['Worker']\n"
    )
    with (
        Remote(sys.executable, str(starter)) as remote,
        pytest.raises(BridgeError, match="there is no such table") as told,
    ):
        remote("reset", id="kinder/Any-v0", seed=0)
    assert "in reset" in str(told.value)


def test_a_missing_interpreter_is_told(tmp_path: Path) -> None:
    with pytest.raises(BridgeError, match="cannot be started"):
        Remote(tmp_path / "python", "kinder_worker.py")


@pytest.mark.slow
@pytest.mark.skipif("KINDER_PYTHON" not in os.environ, reason="KinDER runs in an environment of its own")
def test_a_task_of_kinder_is_solved_by_its_own_check() -> None:
    from clutter_env.bridges.kinder_tasks import KinderTask
    from planners import TampExpert

    with Remote(os.environ["KINDER_PYTHON"], "kinder_worker.py") as kinder:
        task = KinderTask(kinder, "kinder/PickPlace3D-o1-v0", seed=0)
        expert = TampExpert(task.world)
        expert.reset()
        while not expert.done:
            task.world.step(expert.act())
        assert task.is_solved
        assert expert.report.scored


@pytest.mark.slow
@pytest.mark.skipif("ROBOSUITE_PYTHON" not in os.environ, reason="robosuite runs in an environment of its own")
def test_a_task_of_robosuite_is_solved_by_its_own_check() -> None:
    from clutter_env.bridges.robosuite_tasks import GRASPS, RobosuiteTask
    from planners import TampExpert

    with Remote(os.environ["ROBOSUITE_PYTHON"], "robosuite_worker.py") as robosuite:
        with pytest.raises(BridgeError, match="there are Lift, Stack, PickPlace"):
            RobosuiteTask(robosuite, "Door", seed=0)
        task = RobosuiteTask(robosuite, "Lift", seed=0)
        expert = TampExpert(task.world, grasps=GRASPS)
        expert.reset()
        while not (expert.done or task.world.is_over):
            task.world.step(expert.act())
        assert task.is_solved
        assert expert.report.scored
