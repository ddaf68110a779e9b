"""The process of a policy: whatever the policy does to its process is told, and ends with it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numba.core import event

from clutter_env.evaluation import policy_process
from clutter_env.evaluation.evaluate import _Job, _play_in_worker
from clutter_env.evaluation.policy_process import PolicyProcess
from clutter_env.evaluation.scenes import SceneSet, SeededScene
from clutter_env.evaluation.score import PolicyCrashed, one_line
from clutter_env.policies.protocol import PolicyError
from clutter_env.policies.registry import PolicyTraits

SCENES = SceneSet("side-15-v3", count=1)
MODULE = """
import ctypes, os, subprocess, sys, threading, time
import numpy as np

class Base:
    def reset(self, info): ...

class IsANuisance(Base):
    def act(self, _):
        self.act = lambda _: [0.5, 1.5]
        print("printed", flush=True)
        os.write(1, b"written")
        threading.Thread(target=time.sleep, args=(1000,)).start()
        subprocess.Popen(["sleep", "1000"])
        os.chdir("/")
        os.closerange(0, 3)
        return [0.5, 1.5]

class Exits(Base):
    def act(self, _):
        if os.fork() == 0:
            time.sleep(1000)
        os._exit(3)

class WritesItsOwnAnswers(Base):
    def act(self, _):
        for file in range(3, 30):
            try:
                os.write(file, b"9" * 100)
            except OSError:
                pass
        time.sleep(1000)

class IsUnmade:
    def __init__(self):
        raise KeyError("by design")

class Leaves(Base):
    def act(self, _): sys.exit(0)

class Segfaults(Base):
    def act(self, _): ctypes.string_at(0)

class Recurses(Base):
    def act(self, _): return self.act(_)

class Reads(Base):
    def act(self, _): input()

class ClosesEverything(Base):
    def act(self, _):
        os.closerange(0, 256)
        time.sleep(1000)

class IsHuge(Base):
    def act(self, _): return np.zeros(10**8)

class Speaks(Base):
    def act(self, _): return "left"

class Sleeps(Base):
    def act(self, _):
        subprocess.Popen(["sleep", "1000"])
        time.sleep(1000)
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "mine.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def group(process: PolicyProcess) -> str:
    """The processes that are left of a policy's."""
    time.sleep(0.2)
    listed = subprocess.run(["ps", "-o", "stat=", "-s", str(process._process.pid)], capture_output=True, text=True)
    return "".join(line for line in listed.stdout.splitlines() if line[0] != "Z")  # which nobody has asked for since


def test_a_policy_may_print_start_threads_and_close_files() -> None:
    process = PolicyProcess("mine:IsANuisance", 0, "oracle")
    process.reset({})
    assert process.act(np.zeros(2)) == process.act(np.zeros(2)) == [0.5, 1.5]
    assert process.traits.track == "observations"
    assert process.traits.place.endswith("mine.py")
    process.close()
    assert not group(process), "what the policy has started ends with it"


ENDS = {
    "Exits": "ended with exit code 3",
    "WritesItsOwnAnswers": "something else than an answer",
    "IsUnmade": r'mine\.py", line \d+, in __init__.*by design',
    "Leaves": r'mine\.py", line \d+, in act.*SystemExit: 0',
    "Segfaults": "ended by SIGSEGV",
    "Recurses": "RecursionError",
    "Reads": "EOFError",
    "ClosesEverything": "goes on running",
    "IsHuge": r"no action but float64 numbers of shape \(100000000,\)",
    "Speaks": r"no action but <U4",
    "Sleeps": "no answer within 1 s",
}


@pytest.mark.parametrize(
    ("kind", "told"),
    [pytest.param(*item, marks=pytest.mark.slow if k > 1 else ()) for k, item in enumerate(ENDS.items())],
)
def test_what_ends_a_policy_is_told(kind: str, told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if kind == "IsUnmade":
        with pytest.raises(PolicyCrashed, match=f"(?s){told}"):
            PolicyProcess(f"mine:{kind}", 0, "oracle")
        return
    process = PolicyProcess(f"mine:{kind}", 0, "oracle")
    process.reset({})
    if kind == "Sleeps":
        monkeypatch.setattr(policy_process, "ANSWER_LIMIT", 1.0)
    with pytest.raises(PolicyCrashed, match=f"(?s){told}"):
        process.act(np.zeros(2))
    assert process.has_ended
    assert not group(process)


def test_a_policy_cannot_be_of_two_tracks() -> None:
    """It could be of the observations track when it is asked, and receive the environment when it plays."""
    told = PolicyTraits("observations", {}, False, "all", "Base", "elsewhere.py")
    answer = _play_in_worker(_Job("mine:Sleeps", SCENES, 0, "oracle"), (0, told))
    assert isinstance(answer, PolicyCrashed)
    assert "in another process" in str(answer)


@pytest.mark.parametrize(
    "change",
    [
        {"env_keywords": {"success": "lifted"}},
        {"track": "none"},
        {"grasps": "level"},
        {"acts_by_skills": 1},
        {"more": 0},
    ],
    ids=str,
)
def test_what_a_process_says_of_its_policy_is_checked(change: dict[str, object]) -> None:
    """The policy could exchange the check in its own process."""
    valid = vars(PolicyTraits("observations", {"control_mode": "ee"}, False, "all", "Base", "mine.py"))
    assert vars(PolicyTraits.read(valid)) == valid
    with pytest.raises(PolicyError, match="control_mode, obs_mode"):
        PolicyTraits.read({**valid, **change})


def test_what_a_policy_says_of_itself_adds_no_line_to_a_table() -> None:
    said = one_line("gave up 1 |\n| side-15-v3 | mine | 1.00 \x1b[2K" + 1000 * "x")
    assert len(said) == 200
    assert said.isprintable()
    assert "|" not in said


@pytest.mark.slow
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_command_leaves_no_process_behind(ending: signal.Signals) -> None:
    def left() -> set[str]:
        listed = subprocess.run(["ps", "-eo", "pid=,args="], capture_output=True, text=True).stdout.splitlines()
        return {line.split()[0] for line in listed if "sleep 1000" in line or "serve()" in line or "loky" in line}

    before = left()
    words = ["evaluate", "--policy", "mine:Sleeps", "--scenes", "2", "--workers", "2"]
    command = subprocess.Popen(
        [sys.executable, "-m", "clutter_env.cli.main", *words],
        env={**os.environ, "PYTHONPATH": str(Path(policy_process.__file__).parents[2])},
    )
    waited_until = time.monotonic() + 120
    while (
        "sleep"
        not in subprocess.run(
            ["ps", "-o", "args=", "-p", ",".join(left() - before or {"0"})], capture_output=True, text=True
        ).stdout
    ):
        assert time.monotonic() < waited_until
        time.sleep(0.5)
    command.send_signal(ending)
    assert command.wait(60) == (130 if ending == signal.SIGINT else -signal.SIGKILL)
    while left() - before:
        assert time.monotonic() < waited_until
        time.sleep(0.5)


def test_skills_that_compile_their_kernels_say_so(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The first episode of an evaluation compiled in silence."""

    def compiles(*_: object) -> None:
        with event.trigger_event("numba:compile"):
            pass

    monkeypatch.setattr(policy_process, "play_scene", compiles)
    monkeypatch.setattr(policy_process, "Recording", SimpleNamespace(of=lambda *_: None))
    host = policy_process._Host("greedy", 0, "oracle", False, "", ())
    host._play(SeededScene("clutter_env/Retrieve-o1-v0", {}, 0))
    assert "compiling the planner's kernels" in caplog.text
