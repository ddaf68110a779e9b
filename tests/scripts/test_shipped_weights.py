"""The training of the weights of the package, in small."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from clutter_env.evaluation.score import play_scene
from clutter_env.policies.weights import load_weights
from clutter_env.task import Task
from scripts.shipped_weights.__main__ import RECIPES, train
from scripts.shipped_weights.decisions import DecisionBudget


@pytest.mark.slow
def test_weights_of_both_levels_are_trained_kept_and_play(tmp_path: Path) -> None:
    task = Task("clutter_env/Retrieve-o1-v0")
    budget = DecisionBudget(scenes=3, steps=40, rounds=1, round_episodes=1, evaluation=1)
    recipe, said = replace(RECIPES["side"], task=task, decisions=budget, motion_steps=600, plans=3), list[str]()
    policy = train(recipe, tmp_path, log=said.append)
    assert [line.partition(",")[2][:8] for line in said if line.startswith("decisions")] == [" round 0", " round 1"]
    for kind in ("decisions", "motions"):
        _, info = load_weights(tmp_path / f"{kind}.npz", kind)
        assert (info.robot, info.layout, info.grasps) == ("fetch", "paper", "side")
        assert info.provenance["version"]
    env = task.make()
    assert play_scene(1_000_000, env, policy, max_steps=60).steps > 0
    written = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    train(recipe, tmp_path)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == written
