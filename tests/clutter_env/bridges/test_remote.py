"""Environments in another process: answers, what they raise, and their end."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from clutter_env.bridges.remote import BridgeError, Remote

WORKER = """
import json, sys
for line in sys.stdin:
    request = json.loads(line)
    if request["call"] == "leave":
        sys.exit(3)
    fails = request["call"] == "fail"
    print(json.dumps({"error": "ValueError: no"} if fails else {"twice": 2 * request["number"]}), flush=True)
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
        with pytest.raises(BridgeError, match="ended with code 3"):
            remote("leave")


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
