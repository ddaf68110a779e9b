"""Every learner for a few steps; settings, records, and resumed runs."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from clutter_env.cli.main import main
from clutter_env.data.dataset import Dataset, Job
from clutter_env.data.episode import record
from clutter_env.data.episode_file import write_episode
from clutter_env.envs.observation import OBJECT_FIELDS
from clutter_env.errors import DatasetError, LearningError, UnknownTask
from clutter_env.evaluation.score import play_scene
from clutter_env.policies.cloning import ClonedPolicy, feature_vector
from clutter_env.policies.experts import make_expert
from clutter_env.policies.protocol import PolicyError, begin_episode
from clutter_env.policies.registry import load_policy
from clutter_env.policies.runs import load_run
from clutter_env.policies.weights import read_arrays
from clutter_env.seeds import held_out_seeds
from clutter_env.task import Task
from clutter_env.training.cloning import Examples, clone
from clutter_env.training.reinforcement import load_model, make_model, save_model
from clutter_env.training.run import Run, differences, runs_of_seeds
from clutter_env.training.settings import BC, DQN, PPO, SAC, TQC, MaskablePPO, Settings
from clutter_env.training.train import train, train_all

REACH, PICK = Task("clutter_env/ArmReach-v0"), Task("clutter_env/Pick-v0")
RETRIEVE = Task("clutter_env/Retrieve-o1-v0", {"reward_mode": "dense"})
SKILL = Task("clutter_env/Skill-o5-v0", {"simulation": "kinematic"})
BRIEF: dict[str, Any] = {"evaluation_episodes": 1, "evaluation_steps": 5}
SHORT_SAC = SAC(steps=30, checkpoint_every=30, **BRIEF)


@pytest.fixture(scope="module")
def demos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two demonstrations of Pick."""
    dataset = Dataset.open_for(Job(PICK, "pick", episodes=2), tmp_path_factory.mktemp("demos") / "pick")
    env = PICK.make()
    for seed in range(2):
        write_episode(dataset.episode_path(seed), record(PICK, env, make_expert("pick"), seed))
    env.close()
    dataset.finish(range(2))
    return dataset.directory


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A short run of SAC that is complete."""
    run = Run(REACH, SHORT_SAC, tmp_path_factory.mktemp("runs") / "run")
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
    ("settings", "task"),
    [
        (TQC(steps=30, checkpoint_every=30, num_envs=2, **BRIEF), REACH),
        (DQN(steps=30, checkpoint_every=30, **BRIEF), SKILL),
        pytest.param(
            SAC(steps=30, checkpoint_every=30, **BRIEF), Task("clutter_env/ArmPick-v0"), marks=pytest.mark.slow
        ),
        pytest.param(PPO(steps=512, checkpoint_every=512, **BRIEF), SKILL, marks=pytest.mark.slow),
        pytest.param(PPO(steps=512, checkpoint_every=512, **BRIEF), RETRIEVE, marks=pytest.mark.slow),
        pytest.param(MaskablePPO(steps=512, checkpoint_every=512, **BRIEF), SKILL, marks=pytest.mark.slow),
    ],
    ids=lambda value: value.algorithm if isinstance(value, Settings) else value.family,
)
def test_reinforcement_learns_saves_and_resumes(settings: Any, task: Task, tmp_path: Path) -> None:
    run = Run(task, settings, tmp_path / "run")
    assert train(run).history[-1]["steps"] == settings.steps
    longer = replace(run, settings=replace(settings, steps=2 * settings.steps))
    assert train(longer, resume=True).history[-1]["steps"] == 2 * settings.steps
    assert play(run.directory, task) > 0


def test_a_saved_model_is_loaded_whole_and_acts_as_before(tmp_path: Path) -> None:
    settings, env = SAC(steps=130), REACH.make()
    model, again = (make_model(settings, "armreach", env, seed=seed) for seed in (0, 1))
    model.learning_starts = 100  # after the first two episodes
    model.learn(130)
    run = Run(REACH, settings, tmp_path)
    run.write_record()
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
        train(Run(REACH, SHORT_SAC, tmp_path / "run"))
    left = {entry.name for entry in (tmp_path / "run").iterdir() if entry.is_file()}
    assert left == (set() if file == "run.json" else {"run.json"})


def test_a_clone_learns_from_demonstrations_and_acts(demos: Path, tmp_path: Path) -> None:
    run = Run(PICK, BC(demos=demos, steps=20, **BRIEF), tmp_path / "bc")
    assert [entry["examples"] for entry in train(run).history] == [200]
    assert play(run.directory, PICK) == 20
    assert read_arrays(run.directory / "policy.npz")[1]["provenance"]["version"]


def test_demonstrations_of_another_task_are_refused(demos: Path, tmp_path: Path) -> None:
    settings = BC(demos=demos, steps=10, **BRIEF)
    with pytest.raises(LearningError, match="not of clutter_env/ArmReach-v0"):
        train(Run(REACH, settings, tmp_path / "run"))
    with pytest.raises(LearningError, match="control_mode"):
        train(Run(Task("clutter_env/Pick-v0", {"control_mode": "joint"}), settings, tmp_path / "third"))
    with pytest.raises(DatasetError, match="holds no dataset"):
        train(Run(PICK, replace(settings, demos=tmp_path), tmp_path / "fourth"))


def test_an_algorithm_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LearningError, match="for this one: sac, tqc"):
        train(Run(REACH, MaskablePPO(steps=10), tmp_path / "run"))
    with pytest.raises(UnknownTask, match="clutter_env/Reach-v0"):
        train(Run(Task("clutter_env/Nothing-v0"), SHORT_SAC, tmp_path / "run"))
    with pytest.raises(LearningError, match="steps=0 is not valid"):
        SAC(steps=0)
    with pytest.raises(LearningError, match="seeds=0"):
        runs_of_seeds(Run(REACH, SHORT_SAC, tmp_path / "run"), 0)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("algorithm", "flag"),
    [("sac", "--rounds"), ("sac", "--grasps"), ("bc", "--num-envs"), ("ppo", "--demos"), ("decisions", "--plans")],
)
def test_a_flag_that_the_algorithm_does_not_know_is_an_error(
    algorithm: str, flag: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["train", algorithm, flag, "1"])
    assert ended.value.code == 2
    assert flag in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"settings": TQC(steps=30, checkpoint_every=30, **BRIEF)}, r"algorithm: 'sac' there, 'tqc' now"),
        ({"task": Task("clutter_env/ArmReach-v0", {"reward_mode": "dense"})}, r"reward_mode: None there, 'dense' now"),
        ({"seed": 1}, r"seed: 0 there, 1 now"),
        ({"settings": replace(SHORT_SAC, steps=20)}, r"steps: 30 there, 20 now"),
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
    assert differences(recorded, begun.describe() | {"provenance": recorded["provenance"]}) == []


@pytest.mark.parametrize("content", ["", "[1]", "{}", '{"task": 3, "algorithm": "sac", "steps": 1}'])
def test_a_damaged_record_is_a_plain_error(content: str, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(LearningError, match=r"run\.json is no record"):
        load_run(tmp_path)


def test_damaged_weights_are_a_plain_error(begun: Run, tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    with pytest.raises(PolicyError, match="there is no policy"):
        ClonedPolicy.load(path)
    model = (begun.directory / "model.pt").read_bytes()
    for content in (b"", b"nothing", np.random.default_rng(0).bytes(3000), model[:5000]):
        path.write_bytes(content)
        with pytest.raises(PolicyError, match=r"policy\.npz is damaged"):
            ClonedPolicy.load(path)
    (tmp_path / "run.json").write_bytes((begun.directory / "run.json").read_bytes())
    for content in (b"", model[:5000], model[:-5000]):
        (tmp_path / "model.pt").write_bytes(content)
        with pytest.raises(PolicyError, match=r"model\.pt is damaged"):
            play(tmp_path, REACH)


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
def test_a_run_that_crashes_is_named_after_the_others_have_ended(demos: Path, tmp_path: Path) -> None:
    good = Run(REACH, SHORT_SAC, tmp_path / "a")
    bad = Run(REACH, BC(demos=demos, **BRIEF), tmp_path / "b")  # of another task: seen once it is read
    with pytest.raises(LearningError, match="b: Traceback"):
        train_all([bad, good], workers=1)
    assert (tmp_path / "a" / "history.json").exists()


def test_cloning_fits_what_a_network_can_say(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    features = rng.normal(size=(500, 4)).astype(np.float32)
    actions = np.tanh(features[:, :2] * (1, -1)).astype(np.float32)
    policy = clone(Examples(features, actions), steps=300)
    inputs = torch.from_numpy(features)
    with torch.no_grad():
        assert np.abs(policy(inputs).numpy() - actions).mean() < 0.05
    policy.save(tmp_path / "p.npz")
    assert torch.equal(policy(inputs), ClonedPolicy.load(tmp_path / "p.npz")(inputs))


def test_features_do_not_depend_on_the_order_of_the_objects() -> None:
    env = Task("clutter_env/Retrieve-o5-v0").make()
    observation, _ = env.reset(seed=0)
    rows = observation["objects"].reshape(5, len(OBJECT_FIELDS))
    other = {**observation, "objects": rows[[3, 1, 4, 0, 2]].ravel()}
    assert np.array_equal(feature_vector(observation), feature_vector(other))
