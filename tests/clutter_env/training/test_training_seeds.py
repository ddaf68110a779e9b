"""No scene that is collected or trained on has a seed that is for evaluation."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import clutter_env
from clutter_env.cli.main import main
from clutter_env.data.collect import make_job
from clutter_env.errors import LearningError
from clutter_env.seeds import HELD_OUT, training_seeds
from clutter_env.task import Task
from clutter_env.training.run import Run
from clutter_env.training.settings import SETTINGS, Keyframes, Settings

DEMOS = Path("demos")


def settings_of(kind: type[Settings]) -> list[Settings]:
    """Settings of an algorithm with as many scenes as it may draw."""
    given = {"demos": DEMOS} if kind.algorithm == "bc" else {}
    more = {"rounds": 5} if kind.algorithm == "decisions" else {}
    return [kind(**given), kind(**given, **more)]


def test_suites_and_evaluations_use_no_seed_of_training() -> None:
    assert training_seeds(HELD_OUT - 3, 3) == range(HELD_OUT - 3, HELD_OUT)
    for first, count in ((-1, 1), (HELD_OUT, 1), (HELD_OUT - 3, 4)):
        with pytest.raises(LearningError, match="for evaluation"):
            training_seeds(first, count)
    for name in clutter_env.suite_names():
        assert (
            min(scene.seed for split in ("test", "validation") for scene in clutter_env.suite(name).split(split))
            >= HELD_OUT
        )


@pytest.mark.parametrize("algorithm", SETTINGS)
def test_no_random_seed_of_training_draws_held_out_scenes(algorithm: str) -> None:
    for settings in settings_of(SETTINGS[algorithm]):
        for seed in (*range(100), 10_000, 19_999, 999_999, HELD_OUT, 3 * HELD_OUT):
            try:
                drawn = settings.scene_seeds(seed)
            except LearningError:
                continue
            assert all(part.start >= 0 and part.stop <= HELD_OUT for part in drawn)


@pytest.mark.parametrize("seed", [45, 95])
def test_a_run_on_held_out_scenes_is_refused_before_anything_is_written(seed: int, tmp_path: Path) -> None:
    run = Run(Task("clutter_env/Retrieve-o5-v0"), Keyframes(), tmp_path / "run", seed)
    with pytest.raises(LearningError, match=f"would be {100_000 + 20_000 * seed} to"):
        run.check()
    words = ["train", "keyframes", "--env", "clutter_env/Retrieve-o5-v0", "--seed", str(seed), "--out"]
    with pytest.raises(SystemExit):
        main([*words, str(tmp_path / "run")])
    assert not list(tmp_path.iterdir())


def test_demonstrations_of_held_out_scenes_are_neither_collected_nor_learned_from(tmp_path: Path) -> None:
    task = Task("clutter_env/Retrieve-o5-v0")
    for first, episodes in ((HELD_OUT, 1), (HELD_OUT - 1, 2)):
        with pytest.raises(LearningError, match="for evaluation"):
            make_job(task, "", episodes, first)
    about = {"task": {"env_id": task.env_id, "keywords": {}}, "expert": "lookahead", "first_seed": 0}
    (tmp_path / "dataset.json").write_text(json.dumps(about))
    (tmp_path / "index.json").write_text(json.dumps({"seeds": [3, HELD_OUT + 3]}))
    with pytest.raises(LearningError, match="for evaluation"):
        Run(task, Keyframes(demos=tmp_path), tmp_path / "run").check()
