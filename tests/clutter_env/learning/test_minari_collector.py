"""Minari's own collector works on the environments, with what the extra `[minari]` installs."""

from __future__ import annotations

import importlib.util
import tomllib
from pathlib import Path

import gymnasium as gym
import pytest

import clutter_env  # noqa: F401 - registers the environments

ROOT = Path(__file__).resolve().parents[3]


def test_the_extra_has_what_the_collector_needs() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    (requirement,) = extras["minari"]
    assert requirement.startswith("minari[hdf5,create]")


@pytest.mark.skipif(importlib.util.find_spec("jax") is None, reason="needs the extra [minari]")
@pytest.mark.parametrize("env_id", ["clutter_env/Pick-v0", "clutter_env/Retrieve-o5-v0"])
def test_a_dataset_is_collected(env_id: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = minari.DataCollector(gym.make(env_id))
    for seed in range(2):
        env.reset(seed=seed)
        for _ in range(5):
            env.step(env.action_space.sample())
    dataset = env.create_dataset(dataset_id="test/collected-v0", algorithm_name="random")
    assert dataset.total_steps == 10
    assert dataset.recover_environment().spec.id == env_id
    env.close()
