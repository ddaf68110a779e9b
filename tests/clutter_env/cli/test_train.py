"""`clutter-env train`: its environments, and the advice that it gives."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest

from clutter_env.cli.main import main
from clutter_env.cli.train import Arguments, imitate_plans, make_run
from clutter_env.errors import LearningError

pytest.importorskip("sb3_contrib")
ROOT = Path(__file__).resolve().parents[3]


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


def test_each_algorithm_has_an_environment_of_its_own() -> None:
    made = {name: make_run(Arguments(name)).task for name in ("tqc", "ppo", "maskable-ppo")}  # type: ignore[arg-type]  # str, not Literal
    assert [task.family for task in made.values()] == ["armreach", "retrieve", "skill"]
    assert made["maskable-ppo"].keywords == {"simulation": "kinematic"}


def test_the_objects_to_learn_with_can_be_those_of_a_set() -> None:
    arguments = Arguments("maskable-ppo", env="clutter_env/Skill-o10-v0", object_set="household")
    with closing(make_run(arguments).task.make()) as env:
        config = env.get_wrapper_attr("physics_env").config
        assert (config.num_objects, config.object_set) == (10, "household")


def test_masks_are_for_the_algorithm_that_has_them() -> None:
    """The others learned without, and their records said otherwise."""
    assert make_run(Arguments("maskable-ppo", geometric_mask=True)).task.keywords["geometric_mask"]
    for name in ("dqn", "ppo"):
        with pytest.raises(LearningError, match="masks of maskable-ppo"):
            make_run(Arguments(name, env="clutter_env/Skill-o5-v0", geometric_mask=True))  # type: ignore[arg-type]  # str, not Literal


@pytest.mark.slow
def test_the_weights_of_the_last_step_are_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A run whose steps are no multiple of --checkpoint-every ended with weights that nobody had measured."""
    words = ["train", "sac", "--checkpoint-every", "12", "--evaluation-episodes", "1", "--evaluation-steps", "3"]
    main([*words, "--steps", "20", "--out", str(tmp_path / "run")])
    assert [line.split()[:2] for line in capsys.readouterr().out.splitlines()[:-1]] == [
        ["steps", "12"],
        ["steps", "20"],
    ]


def test_end_to_end_learns_from_plans_of_its_own_scenes_alone() -> None:
    for words in (
        ["--env", "clutter_env/Pick-v0"],
        ["--obstructed"],
        ["--seeds", "2"],
        ["--resume"],
        ["--workers", "1"],
    ):
        with pytest.raises(SystemExit, match="--scenes, --seed and --out alone"):
            main(["train", "end-to-end", *words])
    with pytest.raises(LearningError, match="--scenes, --seed and --out alone"):
        imitate_plans(Arguments("end-to-end", layout="dense"))
    with pytest.raises(SystemExit, match="--scenes is of end-to-end"):
        main(["train", "sac", "--scenes", "20"])
