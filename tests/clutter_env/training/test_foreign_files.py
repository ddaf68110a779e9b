"""Training runs, datasets and results of strangers: loading them executes nothing unless they are trusted by name."""

from __future__ import annotations

import base64
import json
import os
import pickle
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3 import DQN, SAC as SB3_SAC

from clutter_env.cli.main import main
from clutter_env.errors import UnknownTask
from clutter_env.evaluation.evaluate import evaluate
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.score import play_scene
from clutter_env.policies.protocol import PolicyError, begin_episode
from clutter_env.policies.registry import load_policy, policy_files
from clutter_env.policies.weights import load_weights
from clutter_env.task import Task
from clutter_env.training.run import Run
from clutter_env.training.settings import Settings
from clutter_env.training.train import train

REACH, PICK = Task("clutter_env/Reach-v0"), Task("clutter_env/Pick-v0")
SKILL = Task("clutter_env/Skill-o5-v0", {"simulation": "kinematic"})
REACH_SCENES = SceneSet(env_id=REACH.env_id, count=1)
REFUSAL = r"executes code that is in it; .* --trust"


class Executes:
    """Adds the number of the process to a file when it is unpickled."""

    def __init__(self, proof: Path) -> None:
        self.proof = proof

    def __reduce__(self) -> Any:
        return exec, (f"import os; open({str(self.proof)!r}, 'a').write(f'{{os.getpid()}} ')",)


def write_all_formats(directory: Path, proof: Path) -> None:
    """Every file that a version of the package has read in a run, in every format that can hold a pickle."""
    evil = Executes(proof)
    text = base64.b64encode(pickle.dumps(evil)).decode()
    for name in ("model", "policy", "replay_buffer", "motions", "decisions"):
        np.savez(directory / f"{name}.npz", about=np.array(evil), weights=np.array([evil]))
        with zipfile.ZipFile(directory / f"{name}.zip", "w") as archive:
            archive.writestr("data", json.dumps({"policy_class": {":type:": "type", ":serialized:": text}}))
        torch.save(evil, directory / f"{name}.pt")
        (directory / f"{name}.pkl").write_bytes(pickle.dumps(evil))


def test_a_strangers_training_run_executes_nothing(tmp_path: Path) -> None:
    run, env = Run(REACH, "sac", tmp_path / "run"), REACH.make()
    run.write_record()
    write_all_formats(run.directory, tmp_path / "executed")
    resumed = replace(run, settings=Settings(steps=40_000))
    observation, info = env.reset(seed=0)

    def play() -> None:
        policy: Any = load_policy(str(run.directory), 0)
        begin_episode(policy, info, env)
        policy.act(observation)

    with pytest.raises(PolicyError, match=r"model\.pt is damaged"):
        play()
    with pytest.raises(PolicyError, match=r"model\.pt is damaged"):
        train(resumed, resume=True)
    (run.directory / "model.pt").unlink()
    with pytest.raises(PolicyError, match=r"there is no model\.pt"):
        play()
    np.savez(tmp_path / "weights.npz", about=np.array(Executes(tmp_path / "executed")))
    for path in (tmp_path / "weights.npz", run.directory / "motions.npz", run.directory / "decisions.npz"):
        with pytest.raises(PolicyError, match="is damaged"):
            load_weights(path, "motions")
    assert not (tmp_path / "executed").exists()


def test_the_name_of_an_environment_in_a_file_imports_no_module(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "strange.py").write_text("from pathlib import Path; Path('executed').touch()")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(UnknownTask, match="clutter_env/Reach-v0"):
        Task("strange:clutter_env/Reach-v0").make()
    assert not (tmp_path / "executed").exists()


@pytest.fixture
def model(tmp_path: Path) -> str:
    """A model that Stable-Baselines3 saved, in whose file there is code."""
    env = REACH.make()
    made = SB3_SAC("MultiInputPolicy", env, buffer_size=10, policy_kwargs={"net_arch": [8]})
    made.evil = Executes(tmp_path / "executed")
    made.save(tmp_path / "model.zip")
    return f"sac:{tmp_path / 'model.zip'}"


def test_a_model_of_others_is_loaded_only_if_it_is_trusted_and_only_where_it_plays(model: str, tmp_path: Path) -> None:
    proof = tmp_path / "executed"
    with pytest.raises(SystemExit, match=REFUSAL):
        main(["play", "--policy", model])
    assert not proof.exists()
    (score,) = evaluate(model, REACH_SCENES, trust=True).scores
    assert score.steps == 100
    assert proof.read_text()
    assert str(os.getpid()) not in proof.read_text().split()


@pytest.mark.slow
def test_every_command_asks_for_trust_and_no_model_of_others_is_loaded_where_scores_are_made(
    model: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    proof = tmp_path / "executed"
    words = ["--envs", REACH.env_id, "--scenes", "1", "--out", str(tmp_path / "out"), "--policies", model]
    for command in (["evaluate", "--policy", model], ["compare", *words]):
        with pytest.raises(SystemExit, match=REFUSAL):
            main(command)
    assert not proof.exists()
    main(["compare", *words, "--trust"])
    assert "executes code that is in it" in capfd.readouterr().err
    assert str(os.getpid()) not in proof.read_text().split()


def test_a_model_of_others_acts_where_its_spaces_fit(
    model: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(PolicyError, match=r"for observations and actions .* the environment has"):
        play_scene(0, PICK.make(), load_policy(model, 0, trust=True))
    assert "executes code" in caplog.text
    env = SKILL.make()
    DQN("MlpPolicy", env, buffer_size=10).save(tmp_path / "dqn.zip")
    policy: Any = load_policy(f"dqn:{tmp_path / 'dqn.zip'}", 0, trust=True)
    assert policy.acts_by_skills
    assert play_scene(0, env, policy).steps > 0
    assert list(policy_files(f"dqn:{tmp_path / 'dqn.zip'}")) == ["dqn.zip"]
    assert not policy_files("dqn:absent.zip")
    for name, said in ((f"bc:{tmp_path / 'dqn.zip'}", "maskable_ppo"), ("dqn:absent.zip", "there is no file")):
        with pytest.raises(PolicyError, match=said):
            load_policy(name, 0, trust=True)
    (tmp_path / "dqn.zip").write_bytes(b"nothing")
    with pytest.raises(PolicyError, match="cannot be loaded as a model of dqn"):
        load_policy(f"dqn:{tmp_path / 'dqn.zip'}", 0, trust=True)
