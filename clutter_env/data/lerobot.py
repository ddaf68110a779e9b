"""A complete dataset as a LeRobot dataset (format v3.0), written without LeRobot, whose pins clash with others'.

    meta/info.json, meta/stats.json, meta/tasks.parquet, meta/episodes/chunk-000/file-000.parquet
    data/chunk-000/file-000.parquet                  one row a control step
    videos/observation.images.NAME/chunk-000/file-000.mp4

After a large file, file-001 and so on follow, as in LeRobot's own writer. An episode is never divided.
Row t of an episode has the observation before action t. `LeRobotDataset("name", root=DIRECTORY)` reads it.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from itertools import tee
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from clutter_env.bridges.hub import OBSERVATIONS, TASKS, image_entries, joined, number_groups
from clutter_env.data.dataset import Dataset
from clutter_env.data.episode import Episode
from clutter_env.data.episode_file import read_episode
from clutter_env.data.replay import VECTOR, with_images
from clutter_env.errors import DatasetError, LearningError, check_choice, missing_extra
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.rendering.film import CODEC, PIXELS, Video
from clutter_env.reporting.files import write_json, written_atomically

FORMAT = "v3.0"
_CHUNK, _DATA_MB, _VIDEO_MB = 1000, 100, 200
"""Values that LeRobot writes in info.json. The sizes are those at which its own writer begins a new file."""
_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_LINES = 100
"""Episodes whose lines of metadata are written together."""
_INDEX = "__index_level_0__"
"""pandas' name of a column that is a table's index without a name."""
_FEATURES = {"agent_pos": "observation.state", "environment_state": "observation.environment_state"}
_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_LEAST_SPREAD = 0.01
"""[m, rad, m/s] Least standard deviation of observed numbers in the statistics, and least distance from their mean to
their extremes. In demonstrations the quaternion of a level gripper varies less. A policy divides by these values, so a
new tilt would seem hundreds of standard deviations large."""
_FRAMES = 50
"""Most images of an episode that enter the statistics, evenly spaced."""


def export_lerobot(
    dataset: Dataset,
    directory: Path,
    image_size: int = 0,
    workers: int = 1,
    tick: Callable[[], object] = lambda: None,
    observations: str = "",
    cameras: tuple[str, ...] = (),
) -> Path:
    """Write the dataset and return its directory.

    Args:
        dataset: complete.
        directory: a new directory.
        image_size: [pixels] of camera images that are rendered for episodes without images, 0 for none.
        workers: number of processes that render at a time. A single worker is this process.
        tick: called after each episode.
        observations: an entry of `OBSERVATIONS`, the input of policies that learn from the dataset. "" is "images" for
            episodes with images, else "environment_state".
        cameras: cameras to render, as the environment names them. If empty, those of the robot.

    Raises:
        DatasetError: the directory exists, or the dataset is not complete. Or images are requested and none exist. Or
            cameras are named and nothing is rendered.
        UnknownTask: no camera of that name.
        LearningError: pyarrow, or for images PyAV, is not installed, the image size is odd, or a renderer failed.
        RenderingUnavailable: this process has to render images, and this machine cannot.
    """
    if directory.exists():
        raise DatasetError(f"{directory} exists; choose another directory or remove it")
    has_images = bool(image_size or dataset.identity.get("image_size"))
    observations = observations or ("images" if has_images else "environment_state")
    check_choice("observations", observations, OBSERVATIONS)
    if observations == "images" and not has_images:
        raise DatasetError(f"{dataset.directory} was collected without images; render them with --image-size")
    if cameras and (not image_size or dataset.identity.get("image_size")):
        raise DatasetError("cameras are chosen where images are rendered: with an image size, of episodes without any")
    found = iter(dataset)
    if observations == "images":
        found = _shown(dataset, dataset.checked(_with_images(dataset, image_size, cameras, workers)), cameras)
    with written_atomically(directory) as part:
        part.mkdir(parents=True)
        _write(dataset, part, found, observations, tick)
    return directory


def _shown(dataset: Dataset, found: Iterator[Episode], cameras: tuple[str, ...]) -> Iterator[Episode]:
    """Episodes as policies with cameras see them: with only the numbers that the environment shows next to images."""
    with closing(dataset.task.make(obs_mode="rgbd", cameras=cameras)) as env:
        assert isinstance(env.observation_space, spaces.Dict)
        shapes = {name: space.shape or () for name, space in env.observation_space.items()}
    for episode in found:
        entries = [(name, values) for name, values in episode.observations.items() if name in shapes]
        # The entry "observation" of goal environments ends with the objects, unless they are left to the images.
        own = {name: values[:, : shapes[name][0]] if values.ndim == VECTOR else values for name, values in entries}
        yield replace(episode, observations=own)


def _with_images(dataset: Dataset, image_size: int, cameras: tuple[str, ...], workers: int) -> Iterator[Episode]:
    """Episodes in their order, with images of that size added to those without."""
    function = partial(_seen, image_size=image_size, cameras=cameras)
    paths, waiting = tee(map(dataset.episode_path, dataset.seeds))
    if not image_size or workers == 1:
        yield from map(function, paths)
        return
    results, done = run_jobs(function, paths, workers), dict[Path, Episode | Crash | Killed]()
    for wanted in waiting:
        while wanted not in done:
            done |= [next(results)]
        if isinstance(result := done.pop(wanted), Crash | Killed):
            raise LearningError(f"the images of {wanted} could not be rendered: {result.summary}")
        yield result


def _seen(path: Path, image_size: int, cameras: tuple[str, ...]) -> Episode:
    """Read the episode of a file, and add images of that size [pixels] if it has none. With 0 it is unchanged."""
    episode = read_episode(path)
    has_none = not image_entries(episode.observations)
    return with_images(episode, image_size, cameras) if image_size and has_none else episode


class _Files:
    """Files of one kind, beginning with chunk-000/file-000. The last file is open until the end of `stack`.

    The next file begins where LeRobot's own writer begins it: with the rows, or images, that would fill the last file.
    """

    def __init__(self, stack: ExitStack, folder: Path, ending: str, size_mb: float) -> None:
        self._open = stack.enter_context(ExitStack())
        self._folder, self._ending, self._size = folder, ending, size_mb * 2**20
        self._number = self._rows = 0
        self._path, self._file = folder, None

    def place(self, rows: int, prefix: str) -> dict[str, int]:
        """Chunk and file for this number of further rows."""
        if self._rows and self._path.stat().st_size * (1 + rows / self._rows) >= self._size:
            self._open.close()
            self._number, self._rows, self._file = self._number + 1, 0, None
        self._rows += rows
        chunk, file = divmod(self._number, _CHUNK)
        self._path = self._folder / (_FILE.format(chunk_index=chunk, file_index=file) + self._ending)
        return {f"{prefix}/chunk_index": chunk, f"{prefix}/file_index": file}

    def open(self, opened: Callable[[Path], Any]) -> Any:
        """The file at that place. `opened` makes it, as a context manager."""
        if self._file is None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._open.enter_context(opened(self._path))
        return self._file


@dataclass(frozen=True)
class Frames:
    """One episode of T frames.

    Attributes:
        columns: (T, k) or (T,) numbers by feature, with "action", "next.reward", "next.done" and "next.success".
        images: (T, h, w, 3) before each action, by camera.
        names: of the k numbers, by feature.
    """

    columns: dict[str, NDArray[Any]]
    images: dict[str, NDArray[np.uint8]]
    names: Mapping[str, list[str]]


def write_frames(
    directory: Path,
    found: Iterator[Frames],
    count: int,
    fps: int,
    robot: str,
    task: str,
    tick: Callable[[], object] = lambda: None,
) -> None:
    """Write episodes of one task into an existing, empty directory.

    Args:
        directory: of the dataset.
        found: the episodes, all with the same features.
        count: their number.
        fps: frames a second.
        robot: its name.
        task: what to do, in words.
        tick: called after each episode.

    Raises:
        LearningError: pyarrow, or for images PyAV, is not installed.
    """
    try:
        arrow, parquet = (importlib.import_module(name) for name in ("pyarrow", "pyarrow.parquet"))
    except ModuleNotFoundError as problem:
        raise LearningError(missing_extra(problem) or str(problem)) from problem
    first = 0
    features: dict[str, Any] = {}
    statistics: dict[str, list[dict[str, Any]]] = {}
    lines: list[dict[str, Any]] = []
    videos: dict[str, _Files] = {}

    def column(values: NDArray[Any]) -> Any:
        """Numbers (n,), or lists of one length (n, k)."""
        flat = arrow.array(np.ascontiguousarray(values).reshape(-1))
        return flat if values.ndim == 1 else arrow.FixedSizeListArray.from_arrays(flat, values.shape[1])

    def append(files: _Files, table: Any) -> None:
        files.open(partial(parquet.ParquetWriter, schema=table.schema)).write_table(table)

    with ExitStack() as stack:
        data, meta = (_Files(stack, directory / name, ".parquet", _DATA_MB) for name in ("data", "meta/episodes"))
        for index, frames in enumerate(found):
            features = features or _features(frames, fps)
            columns = _numbered(frames, index, first, fps)
            steps = len(columns["index"])
            line: dict[str, Any] = {
                "episode_index": index,
                "tasks": [task],
                "length": steps,
                "dataset_from_index": first,
                "dataset_to_index": first + steps,
                **data.place(steps, "data"),
            }
            append(data, arrow.table({name: column(values) for name, values in columns.items()}))
            first += steps
            own = {name: _vector_statistics(values) for name, values in columns.items()}
            for camera, images in frames.images.items():
                key = f"observation.images.{camera}"
                if key not in videos:
                    videos[key] = _Files(stack, directory / "videos" / key, ".mp4", _VIDEO_MB)
                line |= videos[key].place(len(images), f"videos/{key}")
                video = videos[key].open(partial(Video, size=images.shape[1:3], fps=fps))
                line[f"videos/{key}/from_timestamp"] = video.frames / fps
                video.write(images)
                line[f"videos/{key}/to_timestamp"] = video.frames / fps
                own[key] = _image_statistics(images)
            for name, entry in own.items():
                statistics.setdefault(name, []).append(entry)
                line |= {f"stats/{name}/{kind}": value for kind, value in entry.items()}
            lines.append(line)
            if len(lines) == _LINES or index + 1 == count:
                place = meta.place(len(lines), "meta/episodes")
                append(meta, arrow.Table.from_pylist([line | place for line in lines]))
                statistics = {name: [_all_statistics(entries)] for name, entries in statistics.items()}
                lines.clear()
            tick()

    texts = {"name": None, "field_name": _INDEX, "pandas_type": "unicode", "numpy_type": "object", "metadata": None}
    note = {"index_columns": [_INDEX], "column_indexes": [], "columns": [texts]}  # pandas takes the tasks as index
    tasks = arrow.table({"task_index": np.arange(1), _INDEX: [task]}, metadata={"pandas": json.dumps(note)})
    parquet.write_table(tasks, directory / "meta/tasks.parquet")
    info = {
        "codebase_version": FORMAT,
        "robot_type": robot,
        "total_episodes": count,
        "total_frames": first,
        "total_tasks": 1,
        "chunks_size": _CHUNK,
        "data_files_size_in_mb": _DATA_MB,
        "video_files_size_in_mb": _VIDEO_MB,
        "fps": fps,
        "splits": {"train": f"0:{count}"},
        "data_path": f"data/{_FILE}.parquet",
        "video_path": f"videos/{{video_key}}/{_FILE}.mp4" if videos else None,
        "features": features,
    }
    write_json(directory / "meta/info.json", info)
    for name, (entry,) in statistics.items():
        if name in _FEATURES.values():
            entry["std"] = np.maximum(entry["std"], _LEAST_SPREAD)
            entry["min"] = np.minimum(entry["min"], entry["mean"] - _LEAST_SPREAD)
            entry["max"] = np.maximum(entry["max"], entry["mean"] + _LEAST_SPREAD)
    write_json(directory / "meta/stats.json", {name: entry for name, (entry,) in statistics.items()})


def _write(
    dataset: Dataset, directory: Path, found: Iterator[Episode], observations: str, tick: Callable[[], object]
) -> None:
    with closing(dataset.task.make()) as env:
        fps, robot = int(env.metadata["render_fps"]), str(env.get_wrapper_attr("robot").name)
    frames = (_frames(episode, observations) for episode in found)
    write_frames(directory, frames, len(dataset), fps, robot, TASKS[dataset.task.family], tick)
    identity = {**dataset.identity, "observations": observations}
    write_json(directory / "meta/clutter_env.json", identity)  # LeRobot has no place for it


def _frames(episode: Episode, observations: str) -> Frames:
    """Frames of an episode: the observation before each of its T actions."""

    def column_names(entries: list[str]) -> list[str]:
        sizes = {entry: episode.observations[entry].shape[1] for entry in entries}
        columns = {entry: episode.columns[f"observations/{entry}"].names[:size] for entry, size in sizes.items()}
        return [f"{entry}.{name}" for entry, names in columns.items() for name in names]

    steps = len(episode)
    parts = {name: values[:-1] for name, values in episode.observations.items()}
    groups = number_groups(parts, observations).items()
    columns = {_FEATURES[key]: joined(parts, names) for key, names in groups if names} | {
        "action": episode.actions.astype(np.float32),
        "next.reward": episode.rewards.astype(np.float32),
        "next.done": np.arange(steps) == steps - 1,
        "next.success": episode.is_success[1:].astype(bool),
    }
    cameras = image_entries(episode.observations) if observations == "images" else {}
    names = {_FEATURES[key]: column_names(entries) for key, entries in groups}
    names["action"] = list(episode.columns["actions"].names)
    return Frames(columns, {camera: parts[entry] for camera, entry in cameras.items()}, names)


def _numbered(frames: Frames, index: int, first: int, fps: int) -> dict[str, NDArray[Any]]:
    """Columns of an episode, with those that number its T rows, from `first` on."""
    steps = len(frames.columns["action"])
    frame = np.arange(steps, dtype=np.int64)
    return frames.columns | {
        "timestamp": (frame / fps).astype(np.float32),
        "frame_index": frame,
        "episode_index": np.full(steps, index, np.int64),
        "index": first + frame,
        "task_index": np.zeros(steps, np.int64),
    }


def _features(frames: Frames, fps: int) -> dict[str, dict[str, Any]]:
    """LeRobot's features: type, shape and names of every column and every video."""
    found: dict[str, dict[str, Any]] = {
        name: {"dtype": str(values.dtype), "shape": list(values.shape[1:]) or [1], "names": frames.names.get(name)}
        for name, values in _numbered(frames, 0, 0, fps).items()
    }
    for camera, images in frames.images.items():
        height, width = images.shape[1:3]
        about = {"height": height, "width": width, "channels": 3, "codec": CODEC, "pix_fmt": PIXELS, "fps": fps}
        about = {f"video.{name}": value for name, value in about.items()}
        found[f"observation.images.{camera}"] = {
            "dtype": "video",
            "shape": [height, width, 3],
            "names": ["height", "width", "channels"],
            "info": {**about, "video.is_depth_map": False, "has_audio": False},
        }
    return found


def _vector_statistics(rows: NDArray[Any]) -> dict[str, Any]:
    """Statistics of each column of rows (n, k): min, max, mean, std, quantiles, each a list (k,), and the count [n]."""
    values = np.asarray(rows, dtype=np.float64).reshape(len(rows), -1)
    return {
        **{kind: getattr(values, kind)(axis=0).tolist() for kind in ("min", "max", "mean", "std")},
        "count": [len(values)],
        **dict(zip(_QUANTILES, np.quantile(values, [*_QUANTILES.values()], axis=0).tolist(), strict=True)),
    }


def _image_statistics(images: NDArray[np.uint8]) -> dict[str, Any]:
    """Statistics of each colour of images (n, h, w, 3), from 0 to 1: lists of shape (3, 1, 1)."""
    chosen = images[np.unique(np.linspace(0, len(images) - 1, _FRAMES).round().astype(int))]
    found = _vector_statistics(chosen.reshape(-1, chosen.shape[-1]) / 255.0)
    shaped = {name: [[[value]] for value in values] for name, values in found.items() if name != "count"}
    return {**shaped, "count": [len(chosen)]}


def _all_statistics(entries: list[dict[str, Any]]) -> dict[str, Any]:
    """Statistics of all episodes, from those of each or of groups. All are exact, except the quantiles, which are
    averaged."""
    counts = np.array([entry["count"][0] for entry in entries], dtype=float)
    stacked = {name: np.array([entry[name] for entry in entries]) for name in entries[0] if name != "count"}
    found = {name: np.average(values, axis=0, weights=counts) for name, values in stacked.items()}
    spread = stacked["std"] ** 2 + (stacked["mean"] - found["mean"]) ** 2
    found["min"], found["max"] = stacked["min"].min(axis=0), stacked["max"].max(axis=0)
    found["std"] = np.sqrt(np.average(spread, axis=0, weights=counts))
    return {**found, "count": [int(counts.sum())]}
