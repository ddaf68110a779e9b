"""Exported demonstrations hold the numbers of the episodes, in the layout that the other tool reads."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from abc import ABC
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py
import numpy as np
import pytest

from clutter_env.bridges.hub import OBSERVATIONS, make_one
from clutter_env.cli.main import main
from clutter_env.data import lerobot
from clutter_env.data.dataset import Dataset, Job, Shards
from clutter_env.data.episode import Episode
from clutter_env.data.episode_file import read_episode, write_episode
from clutter_env.data.hdf5 import export_hdf5
from clutter_env.data.lerobot import export_lerobot
from clutter_env.data.minari import export_minari
from clutter_env.data.replay import replay, with_images
from clutter_env.data.robomimic_env import register
from clutter_env.errors import DatasetError, LearningError, UnknownTask
from clutter_env.seeds import HELD_OUT
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


def copies(episodes: list[Episode], seeds: list[int]) -> list[Episode]:
    """These episodes by turns, as if they were those of these seeds."""
    return [dataclasses.replace(episodes[seed % len(episodes)], seed=seed) for seed in seeds]


def small_files(monkeypatch: pytest.MonkeyPatch, data_bytes: float = 0.0, video_bytes: float = 0.0) -> None:
    """Files for LeRobot of these sizes, an episode at least; two in a chunk."""
    settings = {"_CHUNK": 2, "_DATA_MB": data_bytes / 2**20, "_VIDEO_MB": video_bytes / 2**20, "_LINES": 1}
    for name, value in settings.items():
        monkeypatch.setattr(lerobot, name, value)


def numbered(folder: Path) -> list[str]:
    return [str(file.relative_to(folder).with_suffix("")) for file in sorted(folder.glob("*/*"))]


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


def test_several_files_hold_what_one_holds(
    episodes: list[Episode], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pyarrow")
    from pyarrow import concat_tables, parquet

    dataset = stored(copies(episodes, [0, 1, 2, 3, 4]), Job(TASK, "scripted", 5), tmp_path)
    one = export_lerobot(dataset, tmp_path / "one")
    whole = parquet.read_table(one / "data/chunk-000/file-000.parquet")
    assert numbered(one / "meta/episodes") == numbered(one / "data") == ["chunk-000/file-000"]
    small_files(monkeypatch, data_bytes=(one / "data/chunk-000/file-000.parquet").stat().st_size / 2)
    root = export_lerobot(dataset, tmp_path / "several")
    assert numbered(root / "data") == ["chunk-000/file-000", "chunk-000/file-001", "chunk-001/file-000"]
    files = [parquet.read_table(file) for file in sorted(root.glob("data/*/*"))]
    assert concat_tables(files).combine_chunks().equals(whole.combine_chunks())
    lines = [line for file in sorted(root.glob("meta/episodes/*/*")) for line in parquet.read_table(file).to_pylist()]
    for line in lines:
        file = f"data/chunk-{line['data/chunk_index']:03d}/file-{line['data/file_index']:03d}.parquet"
        rows = parquet.read_table(root / file, filters=[("episode_index", "=", line["episode_index"])])
        assert rows["index"].to_pylist() == list(range(line["dataset_from_index"], line["dataset_to_index"])), file
    places = {line.pop(name) for line in lines for name in list(line) if name.endswith(("chunk_index", "file_index"))}
    assert places == {0, 1}
    lines_of_one = parquet.read_table(one / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert lines == [
        {name: value for name, value in line.items() if not name.endswith(("chunk_index", "file_index"))}
        for line in lines_of_one
    ]
    found, wanted = (json.loads((folder / "meta/stats.json").read_text()) for folder in (root, one))
    assert found.keys() == wanted.keys()
    for name, entry in wanted.items():
        for kind, values in entry.items():
            np.testing.assert_allclose(found[name][kind], values, rtol=1e-9, atol=1e-12, err_msg=f"{name} {kind}")


def test_an_exported_episode_is_on_the_disk_before_the_next_is_read(
    episodes: list[Episode], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that memory does not grow with the number of episodes."""
    pytest.importorskip("pyarrow")
    monkeypatch.setattr(lerobot, "_LINES", 1)
    dataset = stored(copies(episodes, [0, 1, 2]), Job(TASK, "scripted", 3), tmp_path)
    sizes: list[dict[str, int]] = []

    def written() -> None:
        sizes.append({file.parts[-3]: file.stat().st_size for file in tmp_path.rglob("*.parquet")})

    export_lerobot(dataset, tmp_path / "out", tick=written)
    for kind in ("data", "episodes"):
        first, second, third = (size[kind] for size in sizes)
        assert 0 < first < second < third, kind


@pytest.mark.usefixtures("needs_gl")
@pytest.mark.parametrize("episodes_a_file", [1, 2])
def test_videos_of_several_files_show_every_frame(
    seen: list[Episode], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, episodes_a_file: int
) -> None:
    pytest.importorskip("pyarrow")
    av = pytest.importorskip("av")
    from pyarrow import parquet

    dataset = stored(copies(seen, [0, 1, 2]), Job(TASK, "scripted", 3, image_size=SIZE), tmp_path)
    one = export_lerobot(dataset, tmp_path / "one")
    name = "videos/observation.images.head"
    whole = (one / name / "chunk-000/file-000.mp4").stat().st_size
    small_files(monkeypatch, video_bytes=whole * (episodes_a_file + 0.5) / 3)
    root = export_lerobot(dataset, tmp_path / "several")
    length, starts = len(seen[0]), [0, 0, 0] if episodes_a_file == 1 else [0, 1, 0]
    files = {
        1: ["chunk-000/file-000", "chunk-000/file-001", "chunk-001/file-000"],
        2: ["chunk-000/file-000", "chunk-000/file-001"],
    }
    assert numbered(root / name) == files[episodes_a_file]
    lines = [line for file in sorted(root.glob("meta/episodes/*/*")) for line in parquet.read_table(file).to_pylist()]
    for line, start in zip(lines, starts, strict=True):
        assert line[f"{name}/from_timestamp"] == start * length / 20
        assert line[f"{name}/to_timestamp"] == (start + 1) * length / 20
        place = f"chunk-{line[f'{name}/chunk_index']:03d}/file-{line[f'{name}/file_index']:03d}.mp4"
        with av.open(str(root / name / place)) as video:
            frames = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
        shown = np.array(frames[start * length : (start + 1) * length], float)
        images = seen[0].observations["head_rgb"][:-1]
        assert shown.shape == images.shape
        assert abs(shown - images).mean(axis=(1, 2, 3)).max() < 6.0, "shades of 255, by compression"


def test_shards_make_the_dataset_of_one_collection(
    episodes: list[Episode], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyarrow")
    first, second = (
        stored(copies(episodes, seeds), Job(TASK, "scripted", len(seeds), seeds[0]), tmp_path / str(seeds[0]))
        for seeds in ([3, 4, 7], [8, 9])
    )
    one = stored(copies(episodes, [3, 4, 7, 8, 9]), Job(TASK, "scripted", 5, 3), tmp_path / "one")
    wanted, found = export_lerobot(one, tmp_path / "wanted"), tmp_path / "found"
    main(["export", "--to", "lerobot", "--demos", str(second.directory), str(first.directory), "--out", str(found)])
    assert f"5 episodes in {found}" in capsys.readouterr().out
    files = sorted(file.relative_to(wanted) for file in wanted.rglob("*") if file.is_file())
    assert sorted(file.relative_to(found) for file in found.rglob("*") if file.is_file()) == files
    assert [file for file in files if (wanted / file).read_bytes() != (found / file).read_bytes()] == []
    joined = Shards.of([second.directory, first.directory])
    with h5py.File(export_hdf5(joined, tmp_path / "all.hdf5"), "r") as file:
        assert [int(file[f"episode_{index}"].attrs["seed"]) for index in range(5)] == one.seeds


def _other_provenance(content: dict[str, Any]) -> None:
    content["provenance"]["environment"]["reward"] = "0" * 16


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda content: content.update(expert="canonical"), "expert: canonical there, scripted in"),
        (lambda content: content["task"].update(keywords={}), "task: .* there, .*'control_mode': 'ee'"),
        (lambda content: content.update(image_size=96), "image_size: 96 there, None in"),
        (_other_provenance, "The environment's reward has changed"),
        (lambda content: content.pop("provenance"), "recorded by version 0.1"),
        (dict, "1 seeds, the lowest 1, are in .*demos too"),
    ],
)
def test_shards_that_differ_or_share_a_seed_are_refused(
    change: Callable[[dict[str, Any]], object],
    said: str,
    dataset: Dataset,
    episodes: list[Episode],
    tmp_path: Path,
) -> None:
    other = stored(copies(episodes, [1, 2]), Job(TASK, "scripted", 2, 1), tmp_path)
    content = json.loads((other.directory / "dataset.json").read_text())
    change(content)
    (other.directory / "dataset.json").write_text(json.dumps(content))
    for directories in ([dataset.directory, other.directory], [other.directory, dataset.directory]):
        with pytest.raises(DatasetError, match=f"{other.directory} does not go with {dataset.directory}.* {said}"):
            Shards.of(directories)


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
    size, cameras = (SIZE, ("top", "gripper")) if observations == "images" else (0, ())
    root = export_lerobot(dataset, tmp_path / "lerobot", size, observations=observations, cameras=cameras)
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
    assert images == {f"observation.images.{name}" for name in cameras}
    assert (len(list(root.rglob("*.mp4"))) == 2) is bool(size)


@pytest.mark.usefixtures("needs_gl")
@pytest.mark.slow
@pytest.mark.skipif(not LEROBOT, reason="LEROBOT_PYTHON names no interpreter that has LeRobot")
def test_lerobot_loads_what_was_exported(seen: list[Episode], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """LeRobot itself reads every item, of several files."""
    pytest.importorskip("pyarrow")
    pytest.importorskip("av")
    three = copies(seen, [0, 1, 2])
    dataset = stored(three, Job(TASK, "scripted", 3, image_size=SIZE), tmp_path)
    one = export_lerobot(dataset, tmp_path / "one")
    video = one / "videos/observation.images.head/chunk-000/file-000.mp4"
    small_files(monkeypatch, video_bytes=video.stat().st_size * 2.5 / 3)
    root = export_lerobot(dataset, tmp_path / "lerobot")
    assert len(list(root.rglob("data/*/*"))) == len(list(root.rglob("meta/episodes/*/*"))) == 3
    # Videos of the gripper's camera are smaller.
    assert [len(numbered(root / f"videos/observation.images.{name}")) for name in ("head", "gripper")] == [2, 1]
    rows = expected(three)
    del rows["observation.environment_state"]  # which policies with cameras must not find
    length = len(seen[0])
    chosen = np.unique(
        [*range(0, 3 * length, 25), *(episode * length + edge for episode in range(3) for edge in (0, length - 1))]
    )
    rows["video/rows"] = chosen
    for camera in ("head", "gripper"):
        frames = np.concatenate([episode.observations[f"{camera}_rgb"][:-1] for episode in three])
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
    assert found["episodes"] == 3
    assert found["task"] == "take the target out of the clutter"
    assert set(found["errors"]) == {"video/observation.images.head", "video/observation.images.gripper"}
    assert "observation.environment_state" not in found["keys"]
    for name, errors in found["errors"].items():  # shades of 255, by frame: what the video's compression changes
        assert np.mean(errors) < 4.0, name
        assert max(errors) < 5.0, f"{name}: {errors} at the rows {chosen}"


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


def test_cameras_that_cannot_be_rendered_are_refused(dataset: Dataset, seen_dataset: Dataset, tmp_path: Path) -> None:
    out = tmp_path / "lerobot"
    for found, size in ((dataset, 0), (seen_dataset, SIZE)):
        with pytest.raises(DatasetError, match="cameras are chosen where images are rendered"):
            export_lerobot(found, out, size, cameras=("top",))
    with pytest.raises(UnknownTask, match=r"'eye' is not valid.*'top', 'head', 'gripper'"):
        export_lerobot(dataset, out, SIZE, cameras=("eye",))
    assert not out.exists()


@pytest.mark.usefixtures("needs_gl")
@pytest.mark.parametrize("cameras", [(), ("top",)])
def test_images_are_those_that_the_environment_shows(
    cameras: tuple[str, ...], seen: list[Episode], episodes: list[Episode]
) -> None:
    episode = with_images(episodes[0], SIZE, cameras) if cameras else seen[0]
    env = TASK.make(obs_mode="rgbd", image_size=SIZE, cameras=cameras)
    observation, _ = env.reset(seed=episode.seed)
    for step in range(30):
        for name in ("top_rgb", "top_depth") if cameras else ("head_rgb", "gripper_rgb", "head_depth"):
            np.testing.assert_array_equal(observation[name], episode.observations[name][step], f"{name}, step {step}")
        observation, *_ = env.step(episode.actions[step])
    env.close()
    assert episode.observations["top_rgb" if cameras else "head_rgb"][0].std() > 10


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
            np.testing.assert_array_equal(demo["states"][:, 1 : 1 + episode.states.shape[1]], episode.states[:-1])
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
    later = env.reset_to({"states": states[30]})
    np.testing.assert_array_equal(later["objects"], episodes[0].observations["objects"][30])
    first_only = 1 + episodes[0].states.shape[1]  # rows of files before there were full states
    env.reset_to({"states": states[0, :first_only]})
    with pytest.raises(LearningError, match="only the first state"):
        env.reset_to({"states": states[1, :first_only]})


@pytest.mark.parametrize("change", [{"seed": HELD_OUT + 7}, {"task": Task("clutter_env/Retrieve-o1-v0")}])
@pytest.mark.parametrize("to", ["lerobot", "minari", "hdf5", "robomimic"])
def test_the_episode_of_another_scene_under_a_seeds_name_is_refused(
    to: str, change: dict[str, Any], episodes: list[Episode], tmp_path: Path
) -> None:
    """Such as one of a suite, from which nothing may be learned."""
    dataset = stored(episodes, Job(TASK, "scripted", len(SEEDS)), tmp_path)
    write_episode(dataset.episode_path(1), dataclasses.replace(episodes[1], **change))
    with pytest.raises(SystemExit, match=r"seed_0000001\.hdf5 is of seed .*, not of seed 1 in"):
        main(["export", "--to", to, "--demos", str(dataset.directory), "--out", str(tmp_path / "out")])
    assert not [file for file in tmp_path.glob("out*/**/*") if file.is_file()]


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
    with pytest.raises(SystemExit, match="--demos names no directory"):
        main(["export", "--to", "hdf5", "--demos"])


@pytest.mark.parametrize("to", ["lerobot", "hdf5"])
def test_a_collection_without_episodes_is_refused(to: str, tmp_path: Path) -> None:
    """LeRobot's tables could not be written, which named a file; the other exports were empty."""
    none = stored([], Job(TASK, "scripted", 1), tmp_path)
    with pytest.raises(SystemExit, match="demos: no episodes"):
        main(["export", "--to", to, "--demos", str(none.directory), "--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()
