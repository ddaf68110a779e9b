"""Training runs of decisions and of motions as policies."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("torch")

import assets
from clutter_env.errors import LearningError
from clutter_env.evaluation.compare import Comparison, run_names
from clutter_env.evaluation.score import DrawnScene, Score, play_scene
from clutter_env.learning.comparison.compare import make_jobs, make_rows
from clutter_env.learning.comparison.jobs import EvaluationJob
from clutter_env.learning.comparison.played import play_policy, played_task
from clutter_env.learning.comparison.scene_sets import SceneSet
from clutter_env.learning.contacts.hierarchical import HierarchicalPolicy
from clutter_env.learning.policies.runs import MOVER_FILE
from clutter_env.policies.registry import load_policy, policy_families, policy_grasps
from clutter_env.policies.runs import DECISIONS_FILE, run_directories
from clutter_env.task import Task
from clutter_env.training.run import Run

O15 = Task("clutter_env/Retrieve-o15-v0", {"obstructed": True})


def written(directory: Path, algorithm: str, weights: str, name: str, seed: int = 0) -> Path:
    """A run with the weights that come with the package."""
    Run(O15, algorithm, 10, directory, seed).write_record()
    shutil.copy(assets.path(f"policies/{weights}"), directory / name)
    return directory


@pytest.fixture
def decisions(tmp_path: Path) -> Path:
    return written(tmp_path / "decisions", "decisions_dagger", "decisions-side.npz", DECISIONS_FILE)


@pytest.fixture
def motions(tmp_path: Path) -> Path:
    return written(tmp_path / "motions", "keyframes", "keyframes-side.npz", MOVER_FILE)


def test_two_runs_joined_are_one_policy_that_retrieves(decisions: Path, motions: Path) -> None:
    name = f"{decisions}+{motions}"
    assert run_directories(name) == (decisions, motions)
    assert policy_families(name) == ("retrieve",)
    policy = load_policy(name, 0)
    assert isinstance(policy, HierarchicalPolicy)
    assert policy_grasps(policy) == "side"
    assert play_scene(DrawnScene(1_000_000), Task("clutter_env/Retrieve-o1-v0").make(), policy).clean


def test_runs_of_decisions_and_of_motions_play_alone(decisions: Path, motions: Path) -> None:
    names = run_names(map(str, (decisions, motions)))
    assert names[str(decisions)] == "decisions_dagger (planner's motions)"
    assert names[str(motions)] == "keyframes (planner's decisions)"
    scenes = SceneSet(env_id="clutter_env/Retrieve-o15-v0", obstructed=True, count=1)
    playing = {job.policy for job in make_jobs(Comparison((scenes,), runs=(decisions, motions)))}
    assert {str(decisions), str(motions)} <= playing
    assert all(isinstance(load_policy(str(run), 0), HierarchicalPolicy) for run in (decisions, motions))


def test_pairs_of_runs_that_differ_in_their_seeds_are_one_row(tmp_path: Path) -> None:
    seeds = (0, 1)
    pairs = [
        "+".join(
            (
                str(written(tmp_path / f"dec/seed-{seed}", "decisions", "decisions-side.npz", DECISIONS_FILE, seed)),
                str(written(tmp_path / f"key/seed-{seed}", "keyframes", "keyframes-side.npz", MOVER_FILE, seed)),
            )
        )
        for seed in seeds
    ]
    scenes = SceneSet(env_id="clutter_env/Retrieve-o1-v0", count=2)
    comparison = Comparison((scenes,), policies=pairs)
    scores = {
        EvaluationJob(scenes, index, pair): replace(Score.of_crash(scene.seed, ""), clean=bool(seed))
        for seed, pair in zip(seeds, pairs, strict=True)
        for index, scene in enumerate(scenes.scenes)
    }
    rows = {row.policy: row for row in make_rows(comparison, scores)}
    row = rows["decisions + keyframes (all learned)"]
    assert (row.runs, row.episodes, row.clean.mean) == (2, 4, 0.5)
    assert not set(pairs) & set(rows)


def test_runs_that_do_not_fit_together_are_refused(decisions: Path, tmp_path: Path) -> None:
    with pytest.raises(LearningError, match="join one of decisions"):
        load_policy(f"{decisions}+{decisions}", 0)
    with pytest.raises(LearningError, match="no policy"):
        load_policy(f"{decisions}+{tmp_path}", 0)


def test_a_film_ends_with_the_score_of_the_episode(tmp_path: Path) -> None:
    played = play_policy(played_task(1, "", False), "keyframes", 1_000_000, tmp_path / "film")
    assert played.score.clean
    assert played.film is not None
    assert played.film.stat().st_size > 10_000
