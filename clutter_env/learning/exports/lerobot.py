"""A complete dataset as a LeRobot dataset (format v3.0), written without LeRobot, whose pins clash with others'.

    meta/info.json, meta/stats.json, meta/tasks.parquet, meta/episodes/chunk-000/file-000.parquet
    data/chunk-000/file-000.parquet                  one row a control step
    videos/observation.images.NAME/chunk-000/file-000.mp4

Row t of an episode has the observation before action t. `LeRobotDataset("name", root=DIRECTORY)` reads it.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.demonstrations.dataset import Dataset
from clutter_env.learning.demonstrations.episode import Episode
from clutter_env.learning.demonstrations.images import with_images
from clutter_env.learning.errors import DatasetError
from clutter_env.learning.exports.hub import TASKS, agent_entries, environment_entries, image_entries
from clutter_env.learning.exports.lerobot_tables import Tables
from clutter_env.learning.exports.statistics import image_statistics, vector_statistics
from clutter_env.learning.exports.video import CODEC, PIXELS, Video
from clutter_env.learning.task import Task
from clutter_env.reporting.files import write_json

__all__ = ["FORMAT", "export_lerobot"]

FORMAT = "v3.0"
_CHUNK, _DATA_MB, _VIDEO_MB = 1000, 100, 200
"""What LeRobot writes in info.json; the sizes are those at which its own writer begins a new file."""
_DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
_FIRST = {"chunk_index": 0, "file_index": 0}

Columns = dict[str, NDArray[Any]]


def export_lerobot(dataset: Dataset, directory: Path, image_size: int = 0) -> Path:
    """Write the dataset; the directory.

    Args:
        dataset: complete.
        directory: a new one.
        image_size: [pixels] of camera images that are rendered for episodes without any; 0 for none.

    Raises:
        DatasetError: the directory exists, or the dataset is not complete.
        LearningError: pyarrow, or for images PyAV, is not installed; an odd image size.
        RenderingUnavailable: images are to be rendered, and this machine cannot render.
    """
    if directory.exists():
        raise DatasetError(f"{directory} exists; choose another directory or remove it")
    part = directory.with_name(f".{directory.name}.{os.getpid()}.part")
    part.mkdir(parents=True)
    try:
        _Export(dataset, part, image_size).write()
        os.replace(part, directory)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return directory


class _Export:
    """One export on its way: features, tables and videos grow episode by episode."""

    def __init__(self, dataset: Dataset, directory: Path, image_size: int) -> None:
        self._dataset, self._directory, self._image_size = dataset, directory, image_size
        env = _environment(dataset)
        try:
            self._fps = int(env.metadata["render_fps"])
            self._robot = str(env.get_wrapper_attr("robot").name)
            assert env.spec is not None
            self._task = TASKS[env.spec.name.partition("-")[0]]
        finally:
            env.close()
        self._features: dict[str, dict[str, Any]] = {}
        self._rows: dict[str, list[NDArray[Any]]] = {}
        self._images: dict[str, list[dict[str, Any]]] = {}

    def write(self) -> None:
        """Write all files."""
        tables = Tables(self._directory)
        with ExitStack() as stack:
            videos: dict[str, Video] = {}
            for index, episode in enumerate(self._dataset):
                self._add(index, self._with_images(episode), tables, videos, stack)
        tables.write(self._features, [self._task])
        total = sum(len(rows) for rows in self._rows["index"])
        write_json(self._directory / "meta" / "info.json", self._info(len(self._dataset), total))
        statistics = {name: vector_statistics(np.concatenate(rows)) for name, rows in self._rows.items()}
        pictures = {name: _mean_statistics(entries) for name, entries in self._images.items()}
        write_json(self._directory / "meta" / "stats.json", statistics | pictures)

    def _with_images(self, episode: Episode) -> Episode:
        if not self._image_size or image_entries(list(episode.observations)):
            return episode
        return with_images(episode, self._image_size)

    def _add(self, index: int, episode: Episode, tables: Tables, videos: dict[str, Video], stack: ExitStack) -> None:
        """One episode: its rows, its frames of the videos, its line in the table of episodes."""
        if not self._features:
            self._features = _features(episode, self._fps)
        first = sum(len(rows) for rows in self._rows.get("index", []))
        columns = _columns(episode, index, first, self._fps)
        statistics = {name: vector_statistics(values) for name, values in columns.items()}
        line: dict[str, Any] = {
            "episode_index": index,
            "tasks": [self._task],
            "length": len(episode),
            "dataset_from_index": first,
            "dataset_to_index": first + len(episode),
            **{f"data/{name}": value for name, value in _FIRST.items()},
            **{f"meta/episodes/{name}": value for name, value in _FIRST.items()},
        }
        for camera, name in image_entries(list(episode.observations)).items():
            key, images = f"observation.images.{camera}", episode.observations[name][:-1]
            if key not in videos:
                path = self._directory / _VIDEO_PATH.format(video_key=key, **_FIRST)
                videos[key] = stack.enter_context(Video(path, images.shape[1:3], self._fps))
            start = videos[key].frames
            videos[key].write(images)
            line |= {f"videos/{key}/{name}": value for name, value in _FIRST.items()}
            line |= {
                f"videos/{key}/from_timestamp": start / self._fps,
                f"videos/{key}/to_timestamp": videos[key].frames / self._fps,
            }
            statistics[key] = image_statistics(images)
            self._images.setdefault(key, []).append(statistics[key])
        for name, values in columns.items():
            self._rows.setdefault(name, []).append(values)
        tables.add(columns, line, statistics)

    def _info(self, episodes: int, frames: int) -> dict[str, Any]:
        has_videos = bool(self._images)
        return {
            "codebase_version": FORMAT,
            "robot_type": self._robot,
            "total_episodes": episodes,
            "total_frames": frames,
            "total_tasks": 1,
            "chunks_size": _CHUNK,
            "data_files_size_in_mb": _DATA_MB,
            "video_files_size_in_mb": _VIDEO_MB,
            "fps": self._fps,
            "splits": {"train": f"0:{episodes}"},
            "data_path": _DATA_PATH,
            "video_path": _VIDEO_PATH if has_videos else None,
            "features": self._features,
        }


def _environment(dataset: Dataset) -> Any:
    task = dataset.identity["task"]
    return Task(task["env_id"], task["keywords"]).make()


def _columns(episode: Episode, index: int, first: int, fps: int) -> Columns:
    """The numbers of an episode, T rows each, by the name of the feature."""
    steps = len(episode)
    frame = np.arange(steps, dtype=np.int64)
    done = frame == steps - 1
    parts = {name: values[:-1] for name, values in episode.observations.items()}
    found = {"observation.state": _joined(parts, agent_entries(list(parts)))}
    environment = environment_entries(list(parts))
    if environment:
        found["observation.environment_state"] = _joined(parts, environment)
    return found | {
        "action": episode.actions.astype(np.float32),
        "next.reward": episode.rewards.astype(np.float32),
        "next.done": done,
        "next.success": episode.is_success[1:].astype(bool),
        "timestamp": (frame / fps).astype(np.float32),
        "frame_index": frame,
        "episode_index": np.full(steps, index, np.int64),
        "index": first + frame,
        "task_index": np.zeros(steps, np.int64),
    }


def _joined(parts: Mapping[str, NDArray[Any]], names: list[str]) -> NDArray[np.float32]:
    return np.concatenate([parts[name].reshape(len(parts[name]), -1) for name in names], axis=1).astype(np.float32)


def _features(episode: Episode, fps: int) -> dict[str, dict[str, Any]]:
    """What LeRobot calls features: type, shape and names of every column and every video."""
    columns = _columns(episode, 0, 0, fps)
    names: dict[str, list[str]] = {
        "observation.state": _names(episode, agent_entries(list(episode.observations))),
        "observation.environment_state": _names(episode, environment_entries(list(episode.observations))),
        "action": list(episode.columns["actions"].names),
    }
    found: dict[str, dict[str, Any]] = {
        name: {"dtype": str(values.dtype), "shape": list(values.shape[1:]) or [1], "names": names.get(name)}
        for name, values in columns.items()
    }
    for camera, entry in image_entries(list(episode.observations)).items():
        height, width = episode.observations[entry].shape[1:3]
        found[f"observation.images.{camera}"] = {
            "dtype": "video",
            "shape": [height, width, 3],
            "names": ["height", "width", "channels"],
            "info": {
                "video.height": height,
                "video.width": width,
                "video.codec": CODEC,
                "video.pix_fmt": PIXELS,
                "video.is_depth_map": False,
                "video.fps": fps,
                "video.channels": 3,
                "has_audio": False,
            },
        }
    return found


def _names(episode: Episode, entries: list[str]) -> list[str]:
    return [f"{entry}.{name}" for entry in entries for name in episode.columns[f"observations/{entry}"].names]


def _mean_statistics(entries: list[dict[str, Any]]) -> dict[str, Any]:
    """Statistics of images of all episodes, from those of each: exact but for the quantiles, which are averaged."""
    counts = np.array([entry["count"][0] for entry in entries], dtype=float)
    shares = (counts / counts.sum()).reshape(-1, 1, 1, 1)
    stacked = {name: np.array([entry[name] for entry in entries]) for name in entries[0] if name != "count"}
    found = {name: (values * shares).sum(axis=0) for name, values in stacked.items()}
    spread = stacked["std"] ** 2 + (stacked["mean"] - found["mean"]) ** 2
    found |= {
        "min": stacked["min"].min(axis=0),
        "max": stacked["max"].max(axis=0),
        "std": np.sqrt((spread * shares).sum(axis=0)),
    }
    return {**{name: values.tolist() for name, values in found.items()}, "count": [int(counts.sum())]}
