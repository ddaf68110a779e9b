"""A disk that becomes full: a clear message that names the file, and nothing half written is left.

A limit of the size of files stands in for the full disk: writing beyond it ends in an OSError as well.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("sb3_contrib")
pytest.importorskip("resource")

ROOT = Path(__file__).resolve().parents[3]
TRAIN = """
from pathlib import Path
from clutter_env.task import Task
from clutter_env.training.run import Run
from clutter_env.training.settings import SAC
from clutter_env.training.train import train
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, ({size}, {size}))
settings = SAC(steps=30, checkpoint_every=30, evaluation_episodes=1, evaluation_steps=5)
try:
    train(Run(Task("clutter_env/Reach-v0"), settings, Path(sys.argv[1])))
except ValueError as problem:
    print(type(problem).__name__, problem)
"""
POLICY = """
from pathlib import Path
from clutter_env.policies.cloning import ClonedPolicy
import resource, sys
path = Path(sys.argv[1]) / "policy.pt"
small, large = ClonedPolicy(4, 2, 4), ClonedPolicy(30, 12)
small.save(path)
before = path.read_bytes()
resource.setrlimit(resource.RLIMIT_FSIZE, ({size}, {size}))
try:
    large.save(path)
except OSError as problem:
    print(problem)
print(path.read_bytes() == before)
"""


def run_with_limit(code: str, size: int, directory: Path) -> subprocess.CompletedProcess[str]:
    """Run code that cannot write files larger than `size` bytes."""
    command = [sys.executable, "-W", "ignore", "-c", code.format(size=size), str(directory)]
    variables = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_DISABLE_JIT": "0"}
    return subprocess.run(command, capture_output=True, text=True, env=variables)


def left_in(directory: Path) -> set[str]:
    """The files that a run left, but for TensorBoard's."""
    return {entry.name for entry in directory.iterdir() if entry.is_file()}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("size", "named", "left"), [(100, "run.json", set()), (20_000, "replay_buffer.pkl", {"run.json"})]
)
def test_training_stops_with_a_message(size: int, named: str, left: set[str], tmp_path: Path) -> None:
    result = run_with_limit(TRAIN, size, tmp_path)
    assert "LearningError training had to stop" in result.stdout, result.stdout + result.stderr
    assert named in result.stdout
    assert left_in(tmp_path) == left


@pytest.mark.slow
def test_a_policy_is_complete_or_the_old_one_stays(tmp_path: Path) -> None:
    result = run_with_limit(POLICY, 5000, tmp_path)
    assert "policy.pt" in result.stdout, result.stderr
    assert "True" in result.stdout
    assert left_in(tmp_path) == {"policy.pt"}
