"""Checkpoints of LeRobot play as policies; what stands in for LeRobot moves by what it is shown.

With LEROBOT_PYTHON, an interpreter that has LeRobot, LeRobot itself trains and plays: `test_imitation.py`.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clutter_env.bridges.hub import make_one
from clutter_env.cli.main import main
from clutter_env.evaluation.evaluate import evaluate
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.tables import results
from clutter_env.policies.protocol import PolicyError, begin_episode
from clutter_env.policies.registry import load_policy, policy_files
from clutter_env.reporting.files import write_json

pytest.importorskip("torch")

LEROBOT = '''
import sys, types
import numpy as np
import torch


class Config:
    def __init__(self, path):
        self.type, self.pretrained_backbone_weights = "act", "to be downloaded"

    from_pretrained = classmethod(lambda cls, path: cls(path))


class Policy:
    """Moves by the mean of all numbers that it is shown, and by a random number."""

    def from_pretrained(path, config):
        assert config.device == "cpu" and config.pretrained_backbone_weights is None
        return Policy()

    def reset(self):
        self.steps = 0

    def select_action(self, batch):
        self.steps += 1
        assert batch.pop("task") == ["lift the object to the point"]
        shown = torch.cat([part.flatten() for _, part in sorted(batch.items())])
        return torch.full((1, 4), float(shown.mean())) + 0.1 * torch.rand(1) + 0.01 * self.steps


class Processor:
    def reset(self):
        pass

    def __call__(self, value):
        return value


def preprocess_observation(observation):
    images = observation.pop("pixels", {})
    assert all(image.dtype == np.uint8 and image.shape[1:] == (16, 16, 3) for image in images.values())
    return {name: torch.from_numpy(part).float() for name, part in {**observation, **images}.items()}


for name, content in {
    "configs.policies": {"PreTrainedConfig": Config},
    "envs.utils": {"preprocess_observation": preprocess_observation},
    "policies.factory": {
        "get_policy_class": lambda kind: Policy,
        "make_pre_post_processors": lambda config, path, preprocessor_overrides: (Processor(), Processor()),
    },
}.items():
    module = sys.modules[f"lerobot.{name}"] = types.ModuleType(name)
    module.__dict__.update(content)
    sys.modules[f"lerobot.{name.partition('.')[0]}"] = types.ModuleType(name)
'''
OBSERVED = {"images": (11, 0), "state": (33, 0), "environment_state": (27, 6)}
"""Numbers of ArmPick in "observation.state" and "observation.environment_state"."""
SCENES = SceneSet(env_id="clutter_env/ArmPick-v0", count=2)
SEEN = {"image_size": 16, "cameras": ("top", "gripper")}


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> str:
    """An interpreter that has what stands in for LeRobot."""
    folder = tmp_path_factory.mktemp("environment")
    (folder / "lerobot").mkdir()
    (folder / "lerobot" / "__init__.py").write_text(LEROBOT)
    interpreter = folder / "python"
    interpreter.write_text(f'#!/bin/sh\nPYTHONPATH="{folder}" exec "{sys.executable}" "$@"\n')
    interpreter.chmod(0o755)
    return str(interpreter)


def checkpoint(folder: Path, observations: str, step: Any = None) -> str:
    """A checkpoint for ArmPick that sees these observations; the name of its policy."""
    state, environment = OBSERVED[observations]
    shapes = {"observation.state": [state], "observation.environment_state": [environment] * bool(environment)}
    if observations == "images":
        shapes |= {f"observation.images.{camera}": [3, 16, 16] for camera in ("top", "gripper")}
    features = {name: {"shape": shape} for name, shape in shapes.items() if shape}
    config = {"input_features": features, "output_features": {"action": {"shape": [4]}}}
    folder.mkdir(exist_ok=True)
    (folder / "config.json").write_text(json.dumps(config))
    steps = [step or {"registry_name": "normalizer_processor", "config": {}}]
    (folder / "policy_preprocessor.json").write_text(json.dumps({"steps": steps}))
    return f"lerobot:{folder}"


@pytest.mark.skipif(os.name == "nt", reason="the interpreter that stands in is a shell script")
def test_a_checkpoint_plays_in_the_observations_track_and_is_scored_by_replay(python: str, tmp_path: Path) -> None:
    policy = checkpoint(tmp_path / "model", "environment_state")
    found, again = (evaluate(policy, SCENES, python=python) for _ in range(2))
    assert found.traits.track == "observations"
    assert set(found.weights) == {"config.json", "policy_preprocessor.json"} == set(policy_files(policy))
    actions = [episode.recording.actions for episode in found.episodes if episode.recording]
    assert [len(part) for part in actions] == [50, 50]
    for one, other in zip(actions, again.episodes, strict=True):
        np.testing.assert_array_equal(one, other.recording.actions if other.recording else None)
    assert not np.array_equal(*actions)


@pytest.mark.skipif(os.name == "nt", reason="the interpreter that stands in is a shell script")
@pytest.mark.usefixtures("needs_gl")
@pytest.mark.parametrize("observations", OBSERVED)
def test_a_policy_is_shown_what_the_environment_of_a_hub_shows(observations: str, python: str, tmp_path: Path) -> None:
    policy: Any = load_policy(checkpoint(tmp_path / "model", observations), 0, python=python)
    hub = make_one(SCENES.env_id, observations, **(SEEN if observations == "images" else {}))
    shown, _ = hub.reset(seed=1)
    env = SCENES.scenes[0].make(**policy.env_keywords)
    observation, info = env.reset(seed=1)
    begin_episode(policy, info, env)
    parts = [*shown.pop("pixels", {}).values(), *shown.values()]
    mean = np.concatenate([np.ravel(part) for part in parts]).mean(dtype=float)
    first = policy.act(observation)
    assert 0.01 <= first[0] - mean < 0.11 + 1e-4
    policy.reset(info)
    np.testing.assert_array_equal(policy.act(observation), first)
    env.close()
    hub.close()


@pytest.mark.skipif(os.name == "nt", reason="the interpreter that stands in is a shell script")
def test_what_cannot_be_played_is_told(python: str, tmp_path: Path) -> None:
    name = checkpoint(tmp_path / "model", "state")
    policy = load_policy(name, 0, python=python)
    for env_id, words in (("Pick-v0", r"4 numbers in an action.*\(10,\)"), ("Retrieve-o1-v0", r"agent_pos")):
        scene = SceneSet(env_id=f"clutter_env/{env_id}", count=1).scenes[0]
        env = scene.make()
        _, info = env.reset(seed=0)
        with pytest.raises(PolicyError, match=words):
            begin_episode(policy, info, env)
        env.close()
    with pytest.raises(PolicyError, match=r"no checkpoint of LeRobot, a directory .*pretrained_model"):
        load_policy(f"lerobot:{tmp_path}", 0, python=python)
    with pytest.raises(SystemExit, match=r"(?s)--python PATH.*No module named 'lerobot'"):
        main(["evaluate", "--policy", name, "--scenes", "1"])


@pytest.mark.skipif(os.name == "nt", reason="the interpreter that stands in is a shell script")
def test_a_checkpoint_plays_fresh_scenes_for_verify(python: str, tmp_path: Path) -> None:
    name, file = checkpoint(tmp_path / "model", "state"), tmp_path / "results.json"
    write_json(file, results(evaluate(name, SCENES, python=python)))
    said = ["--policy", name, "--python", python, "--scenes", "1", "--workers", "1", "--json", str(tmp_path / "found")]
    main(["verify", str(file), *said])
    found = json.loads((tmp_path / "found").read_text())
    assert (found["weights"], found["fresh"]["mean"], found["differences"]) == ("the same", 0.0, [])


@pytest.mark.parametrize("shape", [[], 3, None])
def test_a_damaged_checkpoint_is_told(shape: Any, tmp_path: Path) -> None:
    name = checkpoint(tmp_path / "model", "images")
    config = json.loads((tmp_path / "model" / "config.json").read_text())
    config["input_features"] = {"observation.images.top": {"shape": shape}}
    (tmp_path / "model" / "config.json").write_text(json.dumps(config))
    with pytest.raises(PolicyError, match="no checkpoint of LeRobot"):
        load_policy(name, 0)
    for step in (3, "registry_name"):
        with pytest.raises(PolicyError, match="no checkpoint of LeRobot"):
            load_policy(checkpoint(tmp_path / "other", "state", step), 0)


def test_a_checkpoint_of_strangers_imports_nothing_of_its_choice(python: str, tmp_path: Path) -> None:
    """LeRobot itself would call it."""
    proof = tmp_path / "executed"
    step = {"class": "subprocess.Popen", "config": {"args": ["touch", str(proof)]}}
    with pytest.raises(PolicyError, match=r"subprocess\.Popen.*only its own registered steps"):
        load_policy(checkpoint(tmp_path / "model", "state", step), 0, python=python)
    assert not proof.exists()
