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


@pytest.mark.parametrize("words", [["--algorithm", "maskable_ppo"], ["--steps", "9", "--algorithm=maskable_ppo"]])
def test_the_spelling_of_version_0_1_is_answered_with_the_new_one(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(["train", *words])
    assert end.value.code == 2
    assert "clutter-env train maskable-ppo ..." in capsys.readouterr().err
