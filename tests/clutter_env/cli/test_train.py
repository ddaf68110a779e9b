"""`clutter-env train`: the advice that it gives works."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from clutter_env.cli.main import main
from clutter_env.cli.train import Arguments, make_run
from clutter_env.data.dataset import Dataset, Job
from clutter_env.task import Task
from clutter_env.training.settings import Keyframes, MaskablePPO

pytest.importorskip("sb3_contrib")
ROOT = Path(__file__).resolve().parents[3]


def test_demonstrations_that_are_not_there_are_named_before_anything_is_written(tmp_path: Path) -> None:
    """It said "the last complete checkpoint stays, and --resume goes on from there"; there was none to resume."""
    with pytest.raises(SystemExit, match=r"nosuch.*`clutter-env collect`") as end:
        main(["train", "bc", "--env", "clutter_env/Pick-v0", "--demos", "nosuch", "--out", str(tmp_path / "run")])
    assert "--resume" not in str(end.value)
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_what_ctrl_c_advises_works(tmp_path: Path) -> None:
    """It said "run the same command again", which was refused: the directory holds a run."""
    words = ["train", "sac", "--env", "clutter_env/Reach-v0", "--checkpoint-every", "10", "--evaluation-episodes", "1"]
    words += ["--evaluation-steps", "3", "--out", str(tmp_path / "run")]
    command = [sys.executable, "-m", "clutter_env", *words]
    process = subprocess.Popen([*command, "--steps", "100000"], cwd=ROOT, stderr=subprocess.PIPE, text=True)
    while process.poll() is None and not (tmp_path / "run" / "run.json").exists():
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 130, said
    assert said.splitlines()[-1].endswith("run the same command again with --resume to go on from the last checkpoint")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    again = subprocess.Popen([*command, "--steps", "100000", "--resume"], cwd=ROOT, env=environment)
    time.sleep(20)
    assert again.poll() is None, "it goes on"
    again.send_signal(signal.SIGINT)
    assert again.wait(60) == 130


def test_the_environment_is_that_of_the_demonstrations(tmp_path: Path) -> None:
    """Without --env it was Reach, on which keyframes cannot be learned."""
    task = Task("clutter_env/Retrieve-o5-v0", {"layout": "wide"})
    Dataset.open_for(Job(task, "canonical", 1), tmp_path / "demos")
    run = make_run(Arguments(Keyframes(demos=tmp_path / "demos"), obstructed=True))
    assert run.task == Task(task.env_id, {"layout": "wide", "obstructed": True})
    assert make_run(Arguments(Keyframes())).task.env_id == "clutter_env/Retrieve-o15-v0"
    assert make_run(Arguments(MaskablePPO())).task.keywords == {"simulation": "kinematic"}


@pytest.mark.slow
def test_a_run_without_a_checkpoint_says_why_there_is_no_history(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["train", "sac", "--steps", "20", "--out", str(tmp_path / "run")])
    assert "every --checkpoint-every steps" in capsys.readouterr().out
