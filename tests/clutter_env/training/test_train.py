"""Every learner for a few steps; settings, records, and resumed runs."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from clutter_env.cli.main import main
from clutter_env.errors import LearningError, UnknownTask
from clutter_env.evaluation.score import play_scene
from clutter_env.policies.protocol import PolicyError, begin_episode
from clutter_env.policies.registry import load_policy
from clutter_env.policies.runs import load_run
from clutter_env.reporting.files import changes
from clutter_env.reporting.progress import progress_bar
from clutter_env.seeds import held_out_seeds
from clutter_env.task import Task
from clutter_env.training.run import Run, runs_of_seeds
from clutter_env.training.settings import Settings
from clutter_env.training.train import load_model, make_model, save_model, train, train_all

REACH = Task("clutter_env/ArmReach-v0")
RETRIEVE = Task("clutter_env/Retrieve-o1-v0", {"reward_mode": "dense"})
SKILL = Task("clutter_env/Skill-o5-v0", {"simulation": "kinematic"})
SHORT = Settings(steps=30, checkpoint_every=30, evaluation_episodes=1, evaluation_steps=5)
LONGER = replace(SHORT, steps=512, checkpoint_every=512)


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A short run of SAC that is complete."""
    run = Run(REACH, "sac", tmp_path_factory.mktemp("runs") / "run", settings=SHORT)
    train(run)
    return run


def play(directory: Path, task: Task) -> int:
    """Steps of an episode of a run's policy."""
    env = task.make()
    try:
        return play_scene(held_out_seeds(1)[0], env, load_policy(str(directory), 0), max_steps=20).steps
    finally:
        env.close()


@pytest.mark.parametrize(
    ("algorithm", "settings", "task"),
    [
        ("tqc", replace(SHORT, num_envs=2), REACH),
        ("dqn", SHORT, SKILL),
        pytest.param("sac", SHORT, Task("clutter_env/ArmPick-v0"), marks=pytest.mark.slow),
        pytest.param("ppo", LONGER, SKILL, marks=pytest.mark.slow),
        pytest.param("ppo", LONGER, RETRIEVE, marks=pytest.mark.slow),
        pytest.param("maskable_ppo", LONGER, SKILL, marks=pytest.mark.slow),
    ],
)
def test_reinforcement_learns_saves_and_resumes(algorithm: str, settings: Settings, task: Task, tmp_path: Path) -> None:
    run = Run(task, algorithm, tmp_path / "run", settings=settings)
    assert train(run).history[-1]["steps"] == settings.steps
    longer = replace(run, settings=replace(settings, steps=2 * settings.steps))
    assert train(longer, resume=True).history[-1]["steps"] == 2 * settings.steps
    assert play(run.directory, task) > 0


def test_a_saved_model_is_loaded_whole_and_acts_as_before(tmp_path: Path) -> None:
    settings, env = Settings(steps=130), REACH.make()
    model, again = (make_model("sac", settings, "armreach", env, seed=seed) for seed in (0, 1))
    model.learning_starts = 100  # after the first two episodes
    model.learn(130)
    Run(REACH, "sac", tmp_path).write_record()
    save_model(model, tmp_path / "model.pt")
    load_model(again, tmp_path / "model.pt")
    assert again.num_timesteps == 130
    assert torch.equal(again.log_ent_coef, model.log_ent_coef)
    for mine, other in zip(again.actor.optimizer.state.values(), model.actor.optimizer.state.values(), strict=True):
        assert all(torch.equal(mine[name], other[name]) for name in other)
    observation, info = env.reset(seed=3)
    policy: Any = load_policy(str(tmp_path), 0)
    begin_episode(policy, info, env)
    assert np.array_equal(policy.act(observation), model.predict(observation, deterministic=True)[0])


@pytest.mark.parametrize("file", ["run.json", "model.pt"])
def test_a_full_disk_stops_training_with_a_message(file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace_file = os.replace

    def full(source: Path, target: Path) -> None:
        if Path(target).name == file:
            raise OSError(28, "No space left on device")
        replace_file(source, target)

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(LearningError, match=rf"training had to stop: .*{file}"):
        train(Run(REACH, "sac", tmp_path / "run", settings=SHORT))
    left = {entry.name for entry in (tmp_path / "run").iterdir() if entry.is_file()}
    assert left == (set() if file == "run.json" else {"run.json"})


def test_an_algorithm_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LearningError, match="there do sac, tqc"):
        train(Run(REACH, "maskable_ppo", tmp_path / "run"))
    with pytest.raises(LearningError, match="a2c does not learn on"):
        train(Run(REACH, "a2c", tmp_path / "run"))
    with pytest.raises(UnknownTask, match="clutter_env/Reach-v0"):
        train(Run(Task("clutter_env/Nothing-v0"), "sac", tmp_path / "run"))
    with pytest.raises(LearningError, match="steps=0 is not valid"):
        Settings(steps=0)
    with pytest.raises(LearningError, match="seeds=0"):
        runs_of_seeds(Run(REACH, "sac", tmp_path / "run"), 0)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"algorithm": "tqc"}, r"algorithm: 'sac' there, 'tqc' now"),
        ({"task": Task("clutter_env/ArmReach-v0", {"reward_mode": "dense"})}, r"reward_mode: None there, 'dense' now"),
        ({"seed": 1}, r"seed: 0 there, 1 now"),
        ({"settings": replace(SHORT, steps=20)}, r"steps: 30 there, 20 now"),
    ],
)
def test_another_run_is_not_resumed(begun: Run, change: dict, named: str) -> None:
    before = {file: file.read_bytes() for file in begun.directory.iterdir() if file.is_file()}
    with pytest.raises(LearningError, match="resume it"):
        train(begun)
    with pytest.raises(LearningError, match=named):
        train(replace(begun, **change), resume=True)
    assert {file: file.read_bytes() for file in begun.directory.iterdir() if file.is_file()} == before


def test_a_run_records_what_it_was_made_with(begun: Run) -> None:
    recorded = load_run(begun.directory)
    assert recorded["provenance"]["environment"]["task"] == "ArmReachEnv"
    assert changes(recorded, begun.describe() | {"provenance": recorded["provenance"]}) == []


@pytest.mark.parametrize(
    "change",
    [
        lambda record: record.clear(),
        lambda record: record.update(task=3),
        lambda record: record["task"].update(env_id="clutter_env/Nothing-v0"),
        lambda record: record["task"].update(env_id=3),
        lambda record: record["task"].update(keywords=3),
        lambda record: record["task"].update(keywords={"num_objects": "many"}),
        lambda record: record.update(steps="30"),
        lambda record: record.update(steps=float("inf")),
        lambda record: record.update(provenance=3),
    ],
)
def test_a_damaged_record_is_a_plain_error(
    change: Callable[[dict[str, Any]], object], begun: Run, tmp_path: Path
) -> None:
    record = load_run(begun.directory)
    change(record)
    for content in (json.dumps(record), json.dumps([record]), ""):
        (tmp_path / "run.json").write_text(content)
        with pytest.raises(LearningError, match=r"run\.json is no record"):
            load_run(tmp_path)


@pytest.mark.parametrize("content", ["{", "[3]", "7"])
def test_a_damaged_history_is_a_plain_error(content: str, begun: Run, tmp_path: Path) -> None:
    shutil.copytree(begun.directory, tmp_path / "run")
    (tmp_path / "run" / "history.json").write_text(content)
    with pytest.raises(PolicyError, match=r"history\.json is damaged"):
        train(replace(begun, directory=tmp_path / "run"), resume=True)


@pytest.mark.slow
def test_hindsight_learns_with_more_copies_than_its_first_steps_give_whole_episodes(tmp_path: Path) -> None:
    """After 1,000 steps of 24 copies no episode of 50 steps had ended, from which hindsight could draw."""
    settings = replace(SHORT, steps=2450, num_envs=24, checkpoint_every=10_000)
    (end,) = train(Run(REACH, "sac", tmp_path / "run", settings=settings)).history
    assert end["steps"] == 103 * 24
    assert (tmp_path / "run" / "model.pt").exists()


def test_copies_that_share_an_update_shorten_the_time_that_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run of six minutes with four copies was announced as an hour."""
    told = []
    monkeypatch.setattr(
        "clutter_env.training.train.progress_bar", lambda **given: told.append(given["seconds"]) or progress_bar()
    )
    for copies in (1, 2):
        train(Run(REACH, "sac", tmp_path / str(copies), settings=replace(SHORT, num_envs=copies)))
    assert told[1] == pytest.approx(told[0] / 2)


def test_a_damaged_model_is_a_plain_error(begun: Run, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_bytes((begun.directory / "run.json").read_bytes())
    with pytest.raises(PolicyError, match=r"there is no model\.pt"):
        play(tmp_path, REACH)
    model = (begun.directory / "model.pt").read_bytes()
    for content in (b"", b"nothing", np.random.default_rng(0).bytes(3000), model[:5000], model[:-5000]):
        (tmp_path / "model.pt").write_bytes(content)
        with pytest.raises(PolicyError, match=r"model\.pt is damaged"):
            play(tmp_path, REACH)


def test_a_run_for_other_observations_is_not_called_damaged(begun: Run) -> None:
    with pytest.raises(PolicyError, match="trained with other observations"):
        play(begun.directory, Task("clutter_env/ArmPick-v0"))


@pytest.mark.slow
def test_several_seeds_are_trained_in_parallel_and_resumed(tmp_path: Path) -> None:
    words = ["train", "sac", "--env", "clutter_env/ArmReach-v0", "--steps", "30", "--evaluation-episodes", "1"]
    words += ["--seeds", "2", "--evaluation-steps", "5", "--checkpoint-every", "30", "--out", str(tmp_path / "runs")]
    main([*words, "--json", str(tmp_path / "h.json")])
    histories = json.loads((tmp_path / "h.json").read_text())
    assert [(entry["seed"], entry["history"][0]["steps"]) for entry in histories] == [(0, 30), (1, 30)]
    with pytest.raises(SystemExit, match="--resume"):
        main(words)
    main([*words, "--resume", "--steps", "40"])
    assert load_run(tmp_path / "runs" / "seed-0")["steps"] == 40


@pytest.mark.slow
def test_a_run_that_crashes_is_named_after_the_others_have_ended(tmp_path: Path) -> None:
    good = Run(REACH, "sac", tmp_path / "a", settings=SHORT)
    (tmp_path / "b" / "model.pt").mkdir(parents=True)  # met once the model is to be saved
    with pytest.raises(LearningError, match=r"(?s)b: Traceback.*training had to stop"):
        train_all([replace(good, directory=tmp_path / "b"), good], workers=1)
    assert (tmp_path / "a" / "history.json").exists()
