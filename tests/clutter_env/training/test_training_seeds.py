"""No scene that is collected or trained on has a seed that is for evaluation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import clutter_env
from clutter_env.cli.main import main
from clutter_env.data.collect import make_job
from clutter_env.envs.base import BaseEnv
from clutter_env.errors import LearningError
from clutter_env.seeds import HELD_OUT, training_seeds
from clutter_env.task import Task
from clutter_env.training.run import Run
from clutter_env.training.settings import Settings
from clutter_env.training.train import train
from scripts.shipped_weights.__main__ import RECIPES, train as train_shipped

REACH = Task("clutter_env/Reach-v0")


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


def test_a_run_on_held_out_scenes_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    for seed, copies in ((HELD_OUT, 1), (HELD_OUT - 1, 2)):
        words = ["train", "tqc", "--env", REACH.env_id, "--num-envs", str(copies), "--seed", str(seed)]
        with pytest.raises(SystemExit, match="for evaluation"):
            main([*words, "--out", str(tmp_path / "run")])
    Run(REACH, "tqc", tmp_path / "run", HELD_OUT - 1).check()
    for seed in (45, 95):
        with pytest.raises(LearningError, match=f"would be {100_000 + 20_000 * seed} to"):
            train_shipped(RECIPES["side"], tmp_path, seed)
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
        train_shipped(RECIPES["side"], tmp_path / "weights", demos=tmp_path)
    for kind in ("lerobot", "hdf5"):
        with pytest.raises(SystemExit, match="for evaluation"):
            main(["export", "--to", kind, "--demos", str(tmp_path), "--out", str(tmp_path / "export")])


def test_a_training_learns_on_its_own_seeds_and_is_measured_on_held_out_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every seed with which an environment is reset; a reset without one goes on with the environment's generator."""
    given: dict[int, list[int]] = {}
    reset = BaseEnv.reset

    def watched(self: BaseEnv, *, seed: int | None = None, options: Any = None) -> Any:
        if seed is not None:
            given.setdefault(id(self), []).append(seed)
        return reset(self, seed=seed, options=options)

    monkeypatch.setattr(BaseEnv, "reset", watched)
    settings = Settings(steps=4, num_envs=2, checkpoint_every=4, evaluation_episodes=2, evaluation_steps=2)
    train(Run(REACH, "tqc", tmp_path / "run", 7, settings))
    assert sorted(given.values()) == [[7], [8], [HELD_OUT, HELD_OUT + 1]]
