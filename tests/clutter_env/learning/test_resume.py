"""A run is resumed only as what it was begun; a refusal changes nothing."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("sb3_contrib")

from clutter_env.cli.main import main
from clutter_env.learning.errors import LearningError
from clutter_env.learning.policies.runs import differences, load_run
from clutter_env.learning.task import Task
from clutter_env.learning.training.run import Run
from clutter_env.learning.training.seeds import seeds_of, train_all
from clutter_env.learning.training.training import train

REACH = Task("clutter_env/Reach-v0")


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A short run of SAC that is complete."""
    directory = tmp_path_factory.mktemp("runs") / "run"
    run = Run(REACH, "sac", 30, directory, checkpoint_every=30, evaluation_episodes=1, evaluation_steps=5)
    train(run)
    return run


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"algorithm": "tqc"}, r"algorithm: 'sac' there, 'tqc' now"),
        ({"task": Task("clutter_env/Reach-v0", {"reward_mode": "dense"})}, r"reward_mode: None there, 'dense' now"),
        ({"task": Task("clutter_env/Pick-v0")}, r"env_id: 'clutter_env/Reach-v0' there, 'clutter_env/Pick-v0' now"),
        ({"seed": 1}, r"seed: 0 there, 1 now"),
        ({"imitation_steps": 5}, r"imitation_steps: 10000 there, 5 now"),
        ({"evaluation_episodes": 2}, r"evaluation_episodes: 1 there, 2 now"),
        ({"demonstrations": Path("demos")}, r"demonstrations: None there, 'demos' now"),
        ({"steps": 20}, r"steps: 30 there, 20 now"),
    ],
)
def test_another_run_is_not_resumed(begun: Run, change: dict, named: str) -> None:
    before = {file: file.read_bytes() for file in begun.directory.iterdir() if file.is_file()}
    with pytest.raises(LearningError, match=named):
        train(replace(begun, **change), resume=True)
    assert {file: file.read_bytes() for file in begun.directory.iterdir() if file.is_file()} == before


def test_the_same_run_is_resumed_and_may_become_longer(begun: Run) -> None:
    train(replace(begun, checkpoint_every=60), resume=True)
    train(replace(begun, steps=40), resume=True)
    assert load_run(begun.directory)["steps"] == 40


def test_a_record_of_an_earlier_version_is_compared_as_far_as_it_goes() -> None:
    old = {"algorithm": "sac", "task": {"env_id": "a", "keywords": {}}, "seed": 0}
    now = {**old, "settings": {"rounds": 5}}
    assert differences(old, now) == []
    assert differences(old, {**now, "seed": 2}) == ["seed: 0 there, 2 now"]


def test_several_seeds_are_trained_in_parallel_and_resumed(tmp_path: Path) -> None:
    words = ["--env", "clutter_env/Reach-v0", "--steps", "30", "--evaluation-episodes", "1", "--seeds", "2"]
    words += ["--evaluation-steps", "5", "--checkpoint-every", "30", "--out", str(tmp_path / "runs")]
    main(["train", *words, "--json", str(tmp_path / "h.json")])
    histories = json.loads((tmp_path / "h.json").read_text())
    assert [(entry["seed"], entry["history"][0]["steps"]) for entry in histories] == [(0, 30), (1, 30)]
    assert load_run(tmp_path / "runs" / "seed-1")["seed"] == 1
    with pytest.raises(SystemExit, match="--resume"):
        main(["train", *words])
    main(["train", *words, "--resume", "--steps", "40"])
    assert load_run(tmp_path / "runs" / "seed-0")["steps"] == 40


def test_a_run_that_crashes_is_named_after_the_others_have_ended(tmp_path: Path) -> None:
    first = Run(REACH, "sac", 10, tmp_path / "a", checkpoint_every=10, evaluation_episodes=1, evaluation_steps=5)
    second = replace(first, directory=tmp_path / "b", demonstrations=tmp_path / "nothing")
    with pytest.raises(LearningError, match="b: Traceback"):
        train_all([second, first], workers=1)
    assert (tmp_path / "a" / "history.json").exists()


def test_too_few_seeds_are_refused() -> None:
    with pytest.raises(LearningError, match="seeds=0"):
        seeds_of(Run(REACH, "sac", 10, Path("none")), 0)
