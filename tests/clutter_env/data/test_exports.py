"""Exported demonstrations hold the numbers of the episodes, in the layout that the other tool reads."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from abc import ABC
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py
import numpy as np
import pytest

from clutter_env.bridges.hub import OBSERVATIONS, make_one
from clutter_env.cli.main import main
from clutter_env.data.dataset import Dataset, Job
from clutter_env.data.episode import Episode
from clutter_env.data.episode_file import read_episode, write_episode
from clutter_env.data.hdf5 import export_hdf5
from clutter_env.data.lerobot import export_lerobot
from clutter_env.data.minari import export_minari
from clutter_env.data.replay import replay, with_images
from clutter_env.data.robomimic_env import register
from clutter_env.errors import DatasetError, LearningError
from clutter_env.task import Task
from tests.clutter_env.data.conftest import recorded, stored

TASK = Task("clutter_env/Retrieve-o1-v0", {"control_mode": "ee"})
SEEDS = (0, 1)
SIZE = 64
LEROBOT = os.environ.get("LEROBOT_PYTHON", "")
"""An interpreter of an environment with LeRobot, whose pins clash with ours."""


@pytest.fixture(scope="module")
def episodes() -> list[Episode]:
    return [recorded(TASK, "scripted", seed) for seed in SEEDS]


@pytest.fixture(scope="module")
def dataset(episodes: list[Episode], tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return stored(episodes, Job(TASK, "scripted", len(SEEDS)), tmp_path_factory.mktemp("state"))


@pytest.fixture(scope="module")
def seen(episodes: list[Episode]) -> list[Episode]:
    """The first episode with images."""
    return [with_images(episodes[0], SIZE)]


@pytest.fixture(scope="module")
def seen_dataset(seen: list[Episode], tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return stored(seen, Job(TASK, "scripted", 1, image_size=SIZE), tmp_path_factory.mktemp("rgbd"))


def expected(episodes: list[Episode]) -> dict[str, np.ndarray]:
    """All rows of all episodes, as LeRobot's items hold them."""
    agent = ("robot", "tcp", "gripper")
    joined = {
        "observation.state": [np.concatenate([e.observations[name][:-1] for name in agent], axis=1) for e in episodes],
        "observation.environment_state": [
            np.concatenate([e.observations[name][:-1] for name in ("objects", "goal")], axis=1) for e in episodes
        ],
        "action": [e.actions for e in episodes],
        "next.reward": [e.rewards.astype(np.float32) for e in episodes],
        "next.success": [e.is_success[1:] for e in episodes],
        "episode_index": [np.full(len(e), index) for index, e in enumerate(episodes)],
        "frame_index": [np.arange(len(e)) for e in episodes],
        "timestamp": [(np.arange(len(e)) / 20).astype(np.float32) for e in episodes],
    }
    return {name: np.concatenate(parts) for name, parts in joined.items()}


def test_lerobot_tables_hold_the_episodes(dataset: Dataset, episodes: list[Episode], tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    from pyarrow import parquet

    root = export_lerobot(dataset, tmp_path / "lerobot")
    table = parquet.read_table(root / "data/chunk-000/file-000.parquet")
    for name, rows in expected(episodes).items():
        values = table[name].combine_chunks()
        found = values.flatten().to_numpy().reshape(len(rows), -1) if rows.ndim > 1 else values.to_numpy(False)
        np.testing.assert_array_equal(found, rows, err_msg=name)
    info = json.loads((root / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    assert info["fps"] == 20
    assert info["total_frames"] == sum(map(len, episodes)) == len(table)
    assert info["video_path"] is None
    assert len(info["features"]["observation.state"]["names"]) == info["features"]["observation.state"]["shape"][0]
    lines = parquet.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [line["length"] for line in lines] == [len(episode) for episode in episodes]
    assert [line["dataset_to_index"] for line in lines] == np.cumsum([len(e) for e in episodes]).tolist()
    statistics = json.loads((root / "meta/stats.json").read_text())
    for name in ("action", "observation.state", "observation.environment_state"):
        rows, found = expected(episodes)[name].astype(float), statistics[name]
        # What hardly varies in demonstrations is not blown up by policies that divide by its spread.
        least = 0.0 if name == "action" else 0.01
        mean, spread = rows.mean(axis=0), np.maximum(rows.std(axis=0), least)
        np.testing.assert_allclose(found["mean"], mean, atol=1e-9)
        np.testing.assert_allclose(found["std"], spread, atol=1e-7)
        np.testing.assert_allclose(found["min"], np.minimum(rows.min(axis=0), mean - least), atol=1e-9)
        np.testing.assert_allclose(found["max"], np.maximum(rows.max(axis=0), mean + least), atol=1e-9)
        assert found["count"] == [len(table)]


@pytest.mark.usefixtures("needs_gl")
@pytest.mark.parametrize("observations", OBSERVATIONS)
@pytest.mark.parametrize("env_id", ["clutter_env/ArmPick-v0", "clutter_env/Retrieve-o1-v0"])
def test_an_export_holds_what_the_environment_of_a_hub_shows(
    env_id: str, observations: str, episodes: list[Episode], tmp_path: Path
) -> None:
    """Row by row, so that a policy is shown in an evaluation what it has learned from: with images no exact poses."""
    for needed in ("pyarrow", "av"):
        pytest.importorskip(needed)
    from pyarrow import parquet

    task, expert = (TASK, "scripted") if env_id == TASK.env_id else (Task(env_id), "armpick")
    episode = episodes[0] if task is TASK else recorded(task, expert, SEEDS[0])
    dataset = stored([episode], Job(task, expert, 1), tmp_path)
    size = SIZE if observations == "images" else 0
    root = export_lerobot(dataset, tmp_path / "lerobot", size, observations=observations)
    table = parquet.read_table(root / "data/chunk-000/file-000.parquet")
    info = json.loads((root / "meta/info.json").read_text())
    env = make_one(env_id, observations, **task.keywords, **({"image_size": SIZE} if size else {}))
    shown, _ = env.reset(seed=episode.seed)
    for row, action in enumerate(episode.actions[:12]):
        for key, name in (("agent_pos", "observation.state"), ("environment_state", "observation.environment_state")):
            assert (key in shown) == (name in info["features"])
            if key in shown:
                np.testing.assert_array_equal(np.float32(table[name][row].as_py()), shown[key], f"{name}, row {row}")
                assert len(info["features"][name]["names"]) == len(shown[key])
        shown, *_ = env.step(action)
    env.close()
    images = {name for name in info["features"] if name.startswith("observation.images.")}
    assert images == ({f"observation.images.{name}" for name in ("head", "gripper")} if size else set())
    assert (len(list(root.rglob("*.mp4"))) == 2) is bool(size)


@pytest.mark.usefixtures("needs_gl")
@pytest.mark.slow
@pytest.mark.skipif(not LEROBOT, reason="LEROBOT_PYTHON names no interpreter that has LeRobot")
def test_lerobot_loads_what_was_exported(seen_dataset: Dataset, seen: list[Episode], tmp_path: Path) -> None:
    """LeRobot itself reads every item."""
    pytest.importorskip("pyarrow")
    pytest.importorskip("av")
    root = export_lerobot(seen_dataset, tmp_path / "lerobot")
    rows = expected(seen)
    del rows["observation.environment_state"]  # which policies with cameras must not find
    chosen = np.arange(0, len(rows["action"]), 25)
    rows["video/rows"] = chosen
    for camera in ("head", "gripper"):
        frames = np.concatenate([episode.observations[f"{camera}_rgb"][:-1] for episode in seen])
        rows[f"video/observation.images.{camera}"] = frames[chosen].astype(float)
    np.savez(tmp_path / "expected.npz", **rows)
    script = Path(__file__).with_name("load_with_lerobot.py")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment |= {"HF_HOME": str(tmp_path / "hub"), "HF_HUB_OFFLINE": "1"}
    done = subprocess.run(
        [LEROBOT, str(script), str(root), str(tmp_path / "expected.npz")],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert all(found["same"].values()), found["same"]
    assert found["episodes"] == len(seen)
    assert found["task"] == "take the target out of the clutter"
    assert set(found["errors"]) == {"video/observation.images.head", "video/observation.images.gripper"}
    assert "observation.environment_state" not in found["keys"]
    assert max(found["errors"].values()) < 4.0, "shades of 255: what the video's compression changes"


@pytest.mark.usefixtures("needs_gl")
@pytest.mark.slow
def test_two_processes_render_what_one_does_in_the_order_of_the_seeds(dataset: Dataset, tmp_path: Path) -> None:
    for needed in ("pyarrow", "av"):
        pytest.importorskip(needed)
    ticks: list[int] = []
    one, two = (
        export_lerobot(dataset, tmp_path / str(workers), SIZE, workers, lambda: ticks.append(0)) for workers in (1, 2)
    )
    files = [file.relative_to(one) for file in one.rglob("*") if file.is_file()]
    assert sum(file.suffix == ".mp4" for file in files) == 2
    assert [file for file in files if (one / file).read_bytes() != (two / file).read_bytes()] == []
    assert len(ticks) == 2 * len(SEEDS)


@pytest.mark.usefixtures("needs_gl")
def test_images_are_those_that_the_environment_shows(seen: list[Episode]) -> None:
    episode = seen[0]
    env = TASK.make(obs_mode="rgbd", image_size=SIZE)
    observation, _ = env.reset(seed=episode.seed)
    for step in range(30):
        for name in ("head_rgb", "gripper_rgb", "head_depth"):
            np.testing.assert_array_equal(observation[name], episode.observations[name][step], f"{name}, step {step}")
        observation, *_ = env.step(episode.actions[step])
    env.close()
    assert episode.observations["head_rgb"][0].std() > 10


@pytest.mark.usefixtures("needs_gl")
def test_an_episode_with_images_is_kept_and_replays(seen: list[Episode], seen_dataset: Dataset, tmp_path: Path) -> None:
    write_episode(tmp_path / "episode.hdf5", seen[0])
    again = read_episode(tmp_path / "episode.hdf5")
    np.testing.assert_array_equal(again.observations["head_rgb"], seen[0].observations["head_rgb"])
    assert again.columns["observations/head_rgb"].about == "image head_rgb"
    assert replay(again).is_identical
    with pytest.raises(DatasetError, match="image_size"):
        Dataset.open_for(Job(TASK, "scripted", len(SEEDS)), seen_dataset.directory)


@pytest.mark.usefixtures("needs_gl")
def test_minari_reads_images_and_labels(
    seen_dataset: Dataset, seen: list[Episode], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    minari = pytest.importorskip("minari")
    monkeypatch.chdir(tmp_path)
    folder = export_minari(seen_dataset, Path("relative"))
    loaded = minari.MinariDataset(str(folder / "data"))
    assert loaded.observation_space["head_rgb"].shape == (SIZE, SIZE, 3)
    for found, episode in zip(loaded.iterate_episodes(), seen, strict=True):
        np.testing.assert_array_equal(found.observations["head_rgb"], episode.observations["head_rgb"])
        np.testing.assert_array_equal(found.actions, episode.actions)
        np.testing.assert_array_equal(found.infos["state"], episode.states)
        assert len(found.infos["phase"]) == len(episode) + 1
    metadata = json.loads((folder / "data" / "metadata.json").read_text())
    assert (metadata["total_episodes"], metadata["total_steps"]) == (1, len(seen[0]))
    assert metadata["provenance"]["version"]
    assert metadata["columns"]["actions"]["names"] == list(seen[0].columns["actions"].names)


def test_hdf5_has_our_layout_or_that_of_robomimic(dataset: Dataset, episodes: list[Episode], tmp_path: Path) -> None:
    with h5py.File(export_hdf5(dataset, tmp_path / "all.hdf5"), "r") as file:
        assert file.attrs["total_steps"] == sum(map(len, episodes))
        for index, episode in enumerate(episodes):
            np.testing.assert_array_equal(file[f"episode_{index}/infos/state"], episode.states)
            assert list(file[f"episode_{index}/actions"].attrs["names"]) == list(episode.columns["actions"].names)
    path = export_hdf5(dataset, tmp_path / "demo.hdf5", robomimic=True)
    with h5py.File(path, "r") as file:
        assert json.loads(file["data"].attrs["env_args"])["env_kwargs"] == {"control_mode": "ee"}
        assert file["data"].attrs["total"] == sum(map(len, episodes))
        assert [name.decode() for name in file["mask/train"]] == ["demo_0", "demo_1"]
        assert len(file["mask/valid"]) == 0  # of twenty episodes two
        assert "import clutter_env" in file["data"].attrs["about"]
        for index, episode in enumerate(episodes):
            demo = file[f"data/demo_{index}"]
            assert demo.attrs["num_samples"] == len(episode)
            np.testing.assert_array_equal(demo["actions"], episode.actions)
            np.testing.assert_array_equal(demo["obs/robot"], episode.observations["robot"][:-1])
            np.testing.assert_array_equal(demo["next_obs/objects"], episode.observations["objects"][1:])
            np.testing.assert_array_equal(demo["states"][:, 0], episode.seed)
            np.testing.assert_array_equal(demo["states"][:, 1:], episode.states[:-1])
            assert demo["dones"][:].sum() == demo["dones"][-1] == 1
            assert len(demo["states"]) == len(demo["rewards"]) == len(episode)


def test_robomimic_plays_a_demonstration_in_our_environment(
    dataset: Dataset, episodes: list[Episode], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a stand-in for robomimic: its own wrapper is replaced, and its `isinstance` finds an environment."""
    base: Any = ModuleType("robomimic.envs.env_base")
    base.EnvBase = type("EnvBase", (ABC,), {})
    monkeypatch.setitem(sys.modules, "robomimic.envs.env_base", None)
    with pytest.raises(LearningError, match="not installed"):
        register()
    monkeypatch.setitem(sys.modules, "robomimic.envs.env_base", base)
    monkeypatch.setitem(sys.modules, "robomimic.envs.env_gym", None)
    register()
    with h5py.File(export_hdf5(dataset, tmp_path / "demo.hdf5", robomimic=True), "r") as file:
        metadata = json.loads(file["data"].attrs["env_args"])
        states, actions = (file[f"data/demo_0/{name}"][:] for name in ("states", "actions"))
    env = sys.modules["robomimic.envs.env_gym"].EnvGym(metadata["env_name"], **metadata["env_kwargs"])
    assert isinstance(env, base.EnvBase)
    assert env.serialize() == metadata
    first = env.reset_to({"states": states[0]})
    np.testing.assert_array_equal(first["objects"], episodes[0].observations["objects"][0])
    for action in actions:
        env.step(action)
    assert env.is_success() == {"task": True}
    assert env.get_reward() == episodes[0].rewards[-1]
    with pytest.raises(LearningError, match="only the first state"):
        env.reset_to({"states": states[1]})


def test_nothing_is_written_over(dataset: Dataset, tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there.hdf5").touch()
    export_minari(dataset, tmp_path)
    for export, path in ((export_lerobot, "there"), (export_hdf5, "there.hdf5"), (export_minari, "")):
        with pytest.raises(DatasetError, match="exists"):
            export(dataset, tmp_path / path)


@pytest.mark.usefixtures("needs_gl")
def test_an_export_that_fails_leaves_nothing(dataset: Dataset, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    with pytest.raises(LearningError, match="even"):
        export_lerobot(dataset, tmp_path / "lerobot", 33)
    assert list(tmp_path.iterdir()) == []


def test_the_command_exports(dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "demo.hdf5"
    main(["export", "--to", "robomimic", "--demos", str(dataset.directory), "--out", str(out)])
    assert f"2 episodes in {out}" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="collected without images"):
        main(["export", "--to", "lerobot", "--observations", "images", "--demos", str(dataset.directory)])
    with pytest.raises(SystemExit, match="collect --obs-mode rgbd"):
        main(["export", "--to", "hdf5", "--image-size", "64", "--demos", str(dataset.directory)])
    with pytest.raises(SystemExit, match="holds no dataset"):
        main(["export", "--to", "hdf5", "--demos", str(tmp_path)])
