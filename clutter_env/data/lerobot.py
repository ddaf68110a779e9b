"""A complete dataset as a LeRobot dataset (format v3.0), written without LeRobot, whose pins clash with others'.

    meta/info.json, meta/stats.json, meta/tasks.parquet, meta/episodes/chunk-000/file-000.parquet
    data/chunk-000/file-000.parquet                  one row a control step
    videos/observation.images.NAME/chunk-000/file-000.mp4

Row t of an episode has the observation before action t. `LeRobotDataset("name", root=DIRECTORY)` reads it.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from clutter_env.bridges.hub import OBSERVATIONS, TASKS, image_entries, joined, number_groups
from clutter_env.data.dataset import Dataset
from clutter_env.data.episode import Episode
from clutter_env.data.episode_file import read_episode
from clutter_env.data.replay import with_images
from clutter_env.errors import DatasetError, LearningError, check_choice, missing_extra
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.rendering.film import CODEC, PIXELS, Video
from clutter_env.reporting.files import write_json, written_atomically

FORMAT = "v3.0"
_CHUNK, _DATA_MB, _VIDEO_MB = 1000, 100, 200
"""Values that LeRobot writes in info.json; the sizes are those at which its own writer begins a new file."""
_FILE = "chunk-000/file-000"
_FIRST = {"chunk_index": 0, "file_index": 0}
_INDEX = "__index_level_0__"
"""pandas' name of a column that is the index of a table and has no name."""
_FEATURES = {"agent_pos": "observation.state", "environment_state": "observation.environment_state"}
_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_VECTORS = 2
"""Dimensions of the vectors of all steps; images have four, and depth has three."""
_LEAST_SPREAD = 0.01
"""[m, rad, m/s] Least standard deviation of numbers of observations in the statistics, and least distance from their
mean to their extremes. A level gripper's quaternion varies less in demonstrations; a policy, which divides by these,
would see a tilt that no demonstration has as hundreds of standard deviations."""
_FRAMES = 50
"""Images of an episode that count at most in statistics, spread evenly."""


def export_lerobot(
    dataset: Dataset,
    directory: Path,
    image_size: int = 0,
    workers: int = 1,
    tick: Callable[[], object] = lambda: None,
    observations: str = "",
) -> Path:
    """Write the dataset; the directory.

    Args:
        dataset: complete.
        directory: a new one.
        image_size: [pixels] of camera images that are rendered for episodes without any; 0 for none.
        workers: how many processes render at a time; with one it is this process.
        tick: called after each episode.
        observations: one of `OBSERVATIONS`, what policies that learn from it see; "" for "images" where there are any,
            else "environment_state".

    Raises:
        DatasetError: the directory exists, or the dataset is not complete; or images are wanted, and there are none.
        LearningError: pyarrow, or for images PyAV, is not installed; an odd image size; a renderer failed.
        RenderingUnavailable: images are to be rendered by this process, and this machine cannot render.
    """
    if directory.exists():
        raise DatasetError(f"{directory} exists; choose another directory or remove it")
    has_images = bool(image_size or dataset.identity.get("image_size"))
    observations = observations or ("images" if has_images else "environment_state")
    check_choice("observations", observations, OBSERVATIONS)
    if observations == "images" and not has_images:
        raise DatasetError(f"{dataset.directory} was collected without images; render them with --image-size")
    found = _with_images(dataset, image_size if observations == "images" else 0, workers)
    with written_atomically(directory) as part:
        part.mkdir(parents=True)
        _write(dataset, part, _shown(dataset, found, observations), observations, tick)
    return directory


def _shown(dataset: Dataset, found: Iterator[Episode], observations: str) -> Iterator[Episode]:
    """The episodes as policies see them: with images, only the numbers that the environment shows with them."""
    if observations != "images":
        for episode in found:
            entries = episode.observations.items()
            yield replace(episode, observations={name: values for name, values in entries if values.ndim == _VECTORS})
        return
    with closing(dataset.task.make(obs_mode="rgbd")) as env:
        assert isinstance(env.observation_space, spaces.Dict)
        shown = env.observation_space.spaces
    for episode in found:
        own = {name: values for name, values in episode.observations.items() if name in shown}
        # The entry "observation" of goal environments ends with the objects, where they are not left to the images.
        cut = {
            name: values[:, : (shown[name].shape or (0,))[0]] for name, values in own.items() if values.ndim == _VECTORS
        }
        yield replace(episode, observations={**own, **cut})


def _with_images(dataset: Dataset, image_size: int, workers: int) -> Iterator[Episode]:
    """The episodes in their order, with images of that size where they have none."""
    function = partial(_seen, image_size=image_size)
    paths = [dataset.episode_path(seed) for seed in dataset.seeds]
    if not image_size or workers == 1:
        yield from map(function, paths)
        return
    waiting, done = list(paths), dict[Path, Episode]()
    for path, result in run_jobs(function, paths, workers):
        if isinstance(result, Crash | Killed):
            raise LearningError(f"the images of {path} could not be rendered: {result.summary}")
        done[path] = result
        while waiting and waiting[0] in done:
            yield done.pop(waiting.pop(0))


def _seen(path: Path, image_size: int) -> Episode:
    """The episode of a file, with images of that size [pixels] if it has none; with 0 as it is."""
    episode = read_episode(path)
    return with_images(episode, image_size) if image_size and not image_entries(episode.observations) else episode


def _write(
    dataset: Dataset, directory: Path, found: Iterator[Episode], observations: str, tick: Callable[[], object]
) -> None:
    try:
        arrow, parquet = (importlib.import_module(name) for name in ("pyarrow", "pyarrow.parquet"))
    except ModuleNotFoundError as problem:
        raise LearningError(missing_extra(problem) or str(problem)) from problem
    env = dataset.task.make()
    fps, robot = int(env.metadata["render_fps"]), str(env.get_wrapper_attr("robot").name)
    env.close()
    task, first = TASKS[dataset.task.family], 0
    features: dict[str, dict[str, Any]] = {}
    rows: dict[str, list[NDArray[Any]]] = {}
    statistics: dict[str, list[dict[str, Any]]] = {}
    episodes: list[dict[str, Any]] = []
    videos: dict[str, Video] = {}
    with ExitStack() as stack:
        for index, episode in enumerate(found):
            features = features or _features(episode, observations, fps)
            columns = _columns(episode, observations, index, first, fps)
            line: dict[str, Any] = {
                "episode_index": index,
                "tasks": [task],
                "length": len(episode),
                "dataset_from_index": first,
                "dataset_to_index": first + len(episode),
                **{f"data/{name}": value for name, value in _FIRST.items()},
                **{f"meta/episodes/{name}": value for name, value in _FIRST.items()},
            }
            first += len(episode)
            own = {name: _vector_statistics(values) for name, values in columns.items()}
            for camera, name in image_entries(episode.observations).items():
                key, images = f"observation.images.{camera}", episode.observations[name][:-1]
                if key not in videos:
                    path = directory / f"videos/{key}/{_FILE}.mp4"
                    videos[key] = stack.enter_context(Video(path, images.shape[1:3], fps))
                line |= {f"videos/{key}/{name}": value for name, value in _FIRST.items()}
                line[f"videos/{key}/from_timestamp"] = videos[key].frames / fps
                videos[key].write(images)
                line[f"videos/{key}/to_timestamp"] = videos[key].frames / fps
                own[key] = _image_statistics(images)
            for name, values in columns.items():
                rows.setdefault(name, []).append(values)
            for name, entry in own.items():
                statistics.setdefault(name, []).append(entry)
                line |= {f"stats/{name}/{kind}": value for kind, value in entry.items()}
            episodes.append(line)
            tick()

    def column(values: NDArray[Any]) -> Any:
        """Numbers (n,), or lists of one length (n, k)."""
        flat = arrow.array(np.ascontiguousarray(values).reshape(-1))
        return flat if values.ndim == 1 else arrow.FixedSizeListArray.from_arrays(flat, values.shape[1])

    tasks = arrow.table({"task_index": np.arange(1), _INDEX: [task]})
    tables = {
        f"data/{_FILE}": arrow.table({name: column(np.concatenate(parts)) for name, parts in rows.items()}),
        f"meta/episodes/{_FILE}": arrow.Table.from_pylist(episodes),
        "meta/tasks": tasks.replace_schema_metadata({"pandas": json.dumps(_pandas_note())}),
    }
    for name, table in tables.items():
        path = directory / f"{name}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(table, path)
    info = {
        "codebase_version": FORMAT,
        "robot_type": robot,
        "total_episodes": len(episodes),
        "total_frames": first,
        "total_tasks": 1,
        "chunks_size": _CHUNK,
        "data_files_size_in_mb": _DATA_MB,
        "video_files_size_in_mb": _VIDEO_MB,
        "fps": fps,
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4" if videos else None,
        "features": features,
    }
    write_json(directory / "meta/info.json", info)
    identity = {**dataset.identity, "observations": observations}
    write_json(directory / "meta/clutter_env.json", identity)  # LeRobot has no place for it
    of_all = {name: _all_statistics(parts) for name, parts in statistics.items()}
    for name, entry in of_all.items():
        if name in _FEATURES.values():
            entry["std"] = np.maximum(entry["std"], _LEAST_SPREAD)
            entry["min"] = np.minimum(entry["min"], entry["mean"] - _LEAST_SPREAD)
            entry["max"] = np.maximum(entry["max"], entry["mean"] + _LEAST_SPREAD)
    write_json(directory / "meta/stats.json", of_all)


def _columns(episode: Episode, observations: str, index: int, first: int, fps: int) -> dict[str, NDArray[Any]]:
    """The numbers of an episode, T rows each, by the name of the feature."""
    steps = len(episode)
    frame = np.arange(steps, dtype=np.int64)
    parts = {name: values[:-1] for name, values in episode.observations.items()}
    groups = number_groups(parts, observations).items()
    return {_FEATURES[key]: joined(parts, names) for key, names in groups if names} | {
        "action": episode.actions.astype(np.float32),
        "next.reward": episode.rewards.astype(np.float32),
        "next.done": frame == steps - 1,
        "next.success": episode.is_success[1:].astype(bool),
        "timestamp": (frame / fps).astype(np.float32),
        "frame_index": frame,
        "episode_index": np.full(steps, index, np.int64),
        "index": first + frame,
        "task_index": np.zeros(steps, np.int64),
    }


def _features(episode: Episode, observations: str, fps: int) -> dict[str, dict[str, Any]]:
    """LeRobot's features: type, shape and names of every column and every video."""

    def column_names(entries: list[str]) -> list[str]:
        sizes = {entry: episode.observations[entry].shape[1] for entry in entries}
        columns = {entry: episode.columns[f"observations/{entry}"].names[:size] for entry, size in sizes.items()}
        return [f"{entry}.{name}" for entry, names in columns.items() for name in names]

    groups = number_groups(episode.observations, observations).items()
    names = {_FEATURES[key]: column_names(entries) for key, entries in groups}
    names["action"] = list(episode.columns["actions"].names)
    found: dict[str, dict[str, Any]] = {
        name: {"dtype": str(values.dtype), "shape": list(values.shape[1:]) or [1], "names": names.get(name)}
        for name, values in _columns(episode, observations, 0, 0, fps).items()
    }
    for camera, entry in image_entries(episode.observations).items():
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


def _vector_statistics(rows: NDArray[Any]) -> dict[str, Any]:
    """Of each number of rows (n, k): min, max, mean, std, quantiles, each a list (k,), and the count [n]."""
    values = np.asarray(rows, dtype=np.float64).reshape(len(rows), -1)
    return {
        "min": values.min(axis=0).tolist(),
        "max": values.max(axis=0).tolist(),
        "mean": values.mean(axis=0).tolist(),
        "std": values.std(axis=0).tolist(),
        "count": [len(values)],
        **{name: np.quantile(values, share, axis=0).tolist() for name, share in _QUANTILES.items()},
    }


def _image_statistics(images: NDArray[np.uint8]) -> dict[str, Any]:
    """Of each colour of images (n, h, w, 3), from 0 to 1: lists of shape (3, 1, 1)."""
    chosen = images[np.unique(np.linspace(0, len(images) - 1, _FRAMES).round().astype(int))]
    found = _vector_statistics(chosen.reshape(-1, chosen.shape[-1]) / 255.0)
    shaped = {name: [[[value]] for value in values] for name, values in found.items() if name != "count"}
    return {**shaped, "count": [len(chosen)]}


def _all_statistics(entries: list[dict[str, Any]]) -> dict[str, Any]:
    """Statistics of all episodes, from those of each: exact but for the quantiles, which are averaged."""
    counts = np.array([entry["count"][0] for entry in entries], dtype=float)
    stacked = {name: np.array([entry[name] for entry in entries]) for name in entries[0] if name != "count"}
    found = {name: np.average(values, axis=0, weights=counts) for name, values in stacked.items()}
    spread = stacked["std"] ** 2 + (stacked["mean"] - found["mean"]) ** 2
    found["min"], found["max"] = stacked["min"].min(axis=0), stacked["max"].max(axis=0)
    found["std"] = np.sqrt(np.average(spread, axis=0, weights=counts))
    return {**found, "count": [int(counts.sum())]}


def _pandas_note() -> dict[str, Any]:
    """The note by which pandas takes the texts of the tasks as the table's index."""
    text = {"name": None, "pandas_type": "unicode", "numpy_type": "object"}
    number = {"pandas_type": "int64", "numpy_type": "int64", "metadata": None}
    return {
        "index_columns": [_INDEX],
        "column_indexes": [{**text, "field_name": None, "metadata": {"encoding": "UTF-8"}}],
        "columns": [
            {"name": "task_index", "field_name": "task_index", **number},
            {**text, "field_name": _INDEX, "metadata": None},
        ],
        "pandas_version": "2.2.0",
    }
