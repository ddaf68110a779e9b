"""One episode as one HDF5 file: the layout of a Minari episode, and further data that Minari does not need.

    observations/…  actions  rewards  terminations  truncations
    infos/{is_success, num_fallen, num_disturbed, state, skill, phase, contact_skill, contact_object, contact_base,
        contact_tcp, keyframe}
    expert/{plan, report, skills, phases}  attributes: id, seed, total_steps, options, task, versions

Observations and infos have a row for each of the T + 1 states, the others one for each of the T actions. What belongs
to an action (skill, phase, contact, keyframe) stands in the row of the state before it; in the last row there is none.
`infos/skill` and `infos/phase` hold indices into the names in `expert/skills` and `expert/phases`. Every array has the
attributes `about`, `names` and `units`: what a row is, and name and unit of each of its numbers.
"""

from __future__ import annotations

import json
import operator
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.demonstrations.columns import Columns
from clutter_env.learning.demonstrations.episode import Episode
from clutter_env.learning.demonstrations.step_labels import CONTACT_SKILLS, StepLabels
from clutter_env.learning.errors import DatasetError
from clutter_env.learning.task import Task

__all__ = ["read_episode", "write_episode"]

_COMPRESSION: Mapping[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
_NUMBERS = "fiub"
"""NumPy's kinds of numbers: floating, signed, unsigned, bool."""
_TEXT = h5py.string_dtype(encoding="utf-8")


def write_episode(path: Path, episode: Episode) -> None:
    """Write the file.

    Raises:
        OSError: the disk is full or cannot be written.
    """
    with h5py.File(path, "w") as file:
        _write(file, episode)


def read_episode(path: Path) -> Episode:
    """The episode in that file.

    Raises:
        DatasetError: there is no such file, it is damaged, or it holds no episode.
    """
    try:
        with h5py.File(path, "r") as file:
            episode = _read(file)
    except (OSError, RuntimeError, ArithmeticError, LookupError, TypeError, ValueError, AttributeError) as problem:
        raise DatasetError(f"{path} holds no episode of this package, or it is damaged: {problem}") from problem
    wrong = _wrong_entry(episode)
    if wrong:
        raise DatasetError(f"{path} holds no episode of this package, or it is damaged: {wrong}")
    return episode


def _wrong_entry(episode: Episode) -> str:
    """What does not fit in an episode of T actions, in words; "" if all does."""
    steps = len(episode)
    expected: list[tuple[str, NDArray[Any], int, int, str]] = [
        ("actions", episode.actions, steps, 2, "f"),
        ("rewards", episode.rewards, steps, 1, "f"),
        ("infos/is_success", episode.is_success, steps + 1, 1, "b"),
        ("infos/num_fallen", episode.num_fallen, steps + 1, 1, "iu"),
        ("infos/num_disturbed", episode.num_disturbed, steps + 1, 1, "iu"),
        ("infos/state", episode.states, steps + 1, 2, "f"),
        *((name, array, steps, ndim, kind) for name, array, ndim, kind in _label_arrays(episode.labels)),
    ]
    for name, array, length, dimensions, kinds in expected:
        if array.ndim != dimensions or len(array) != length or array.dtype.kind not in kinds:
            return f"{name} has shape {array.shape} and type {array.dtype}, with {steps} actions"
    for name, array in episode.observations.items():
        if array.ndim < 2 or len(array) != steps + 1 or array.dtype.kind not in _NUMBERS:
            return f"observations/{name} has shape {array.shape} and type {array.dtype}, with {steps} actions"
    for name, count in (("skill", len(episode.skills)), ("phase", len(episode.labels.phases))):
        if count != steps:
            return f"infos/{name} has {count} entries for {steps} actions"
    if not np.isin(episode.labels.skill, np.arange(len(CONTACT_SKILLS))).all():
        return f"infos/contact_skill has numbers other than 0 to {len(CONTACT_SKILLS) - 1}"
    return ""


def _write(file: h5py.File, episode: Episode) -> None:
    steps = len(episode)
    file.attrs.update(
        {
            "id": 0,
            "seed": episode.seed,
            "total_steps": steps,
            "options": json.dumps(episode.options),
            "task": episode.task.to_json(),
            "versions": json.dumps(dict(episode.versions)),
        }
    )
    ends = np.zeros((2, steps), dtype=bool)
    ends[:, -1] = episode.terminated, episode.truncated
    names, phases, labels = sorted(set(episode.skills)), sorted(set(episode.labels.phases)), episode.labels
    arrays: dict[str, NDArray[Any]] = {f"observations/{name}": value for name, value in episode.observations.items()}
    arrays |= {"actions": episode.actions, "rewards": episode.rewards, "terminations": ends[0], "truncations": ends[1]}
    arrays["infos/is_success"] = episode.is_success
    arrays["infos/num_fallen"] = episode.num_fallen
    arrays["infos/num_disturbed"] = episode.num_disturbed
    arrays["infos/state"] = episode.states
    arrays["infos/skill"] = _with_last_row(np.array([names.index(name) for name in episode.skills], np.int64), -1)
    arrays["infos/phase"] = _with_last_row(np.array([phases.index(name) for name in labels.phases], np.int64), -1)
    for name, values, *_ in _label_arrays(labels):
        none = np.nan if values.dtype.kind == "f" else 0 if name == "infos/contact_skill" else -1
        arrays[name] = _with_last_row(values, none)
    for name, values in arrays.items():
        dataset = file.create_dataset(name, data=values, chunks=True, **_COMPRESSION)
        _describe(dataset, episode.columns[name])
    file.create_dataset("expert/plan", data=episode.plan, dtype=_TEXT)
    file.create_dataset("expert/report", data=json.dumps(dict(episode.report)), dtype=_TEXT)
    file.create_dataset("expert/skills", data=names, dtype=_TEXT)
    file.create_dataset("expert/phases", data=phases, dtype=_TEXT)


def _label_arrays(labels: StepLabels) -> list[tuple[str, NDArray[Any], int, str]]:
    """The arrays of labels but the phases: name in the file, a row for each action, number of dimensions, kind."""
    return [
        ("infos/contact_skill", labels.skill, 1, "i"),
        ("infos/contact_object", labels.object, 1, "i"),
        ("infos/contact_base", labels.contact_base, 2, "f"),
        ("infos/contact_tcp", labels.contact_tcp, 3, "f"),
        ("infos/keyframe", labels.keyframe, 2, "f"),
    ]


def _with_last_row(rows: NDArray[Any], none: float) -> NDArray[Any]:
    """Rows of actions, and one of the last state, to which no action belongs."""
    return np.concatenate((rows, np.full((1, *rows.shape[1:]), none, rows.dtype)))


def _describe(dataset: h5py.Dataset, columns: Columns) -> None:
    dataset.attrs["about"] = columns.about
    dataset.attrs.create("names", list(columns.names), dtype=_TEXT, shape=(len(columns.names),))
    dataset.attrs.create("units", list(columns.units), dtype=_TEXT, shape=(len(columns.units),))


def _read(file: h5py.File) -> Episode:
    return Episode(
        task=Task.from_json(file.attrs["task"]),
        seed=operator.index(file.attrs["seed"]),
        options=_mapping(file.attrs["options"], may_be_none=True),
        observations={name: _array(values) for name, values in file["observations"].items()},
        actions=_array(file["actions"]),
        rewards=_array(file["rewards"]),
        terminated=_last_flag(file["terminations"]),
        truncated=_last_flag(file["truncations"]),
        is_success=_array(file["infos/is_success"]),
        num_fallen=_array(file["infos/num_fallen"]),
        states=_array(file["infos/state"]),
        num_disturbed=_array(file["infos/num_disturbed"]),
        skills=_names(file, "expert/skills", "infos/skill"),
        labels=_read_labels(file),
        columns=_read_columns(file),
        plan=file["expert/plan"][()].decode(),
        report=_mapping(file["expert/report"][()]),
        versions=_mapping(file.attrs["versions"]),
    )


def _read_labels(file: h5py.File) -> StepLabels:
    return StepLabels(
        _names(file, "expert/phases", "infos/phase"),
        _of_actions(file["infos/contact_skill"]),
        _of_actions(file["infos/contact_object"]),
        _of_actions(file["infos/contact_base"]),
        _of_actions(file["infos/contact_tcp"]),
        _of_actions(file["infos/keyframe"]),
    )


def _read_columns(file: h5py.File) -> dict[str, Columns]:
    """The names and units of all arrays that have some."""
    found: dict[str, Columns] = {}

    def read(name: str, entry: h5py.Group | h5py.Dataset) -> None:
        """Those of one array."""
        if isinstance(entry, h5py.Dataset) and "about" in entry.attrs:
            about, names, units = (entry.attrs[key] for key in ("about", "names", "units"))
            found[name] = Columns(str(about), tuple(map(str, names)), tuple(map(str, units)))

    file.visititems(read)
    return found


def _of_actions(values: h5py.Dataset) -> NDArray[Any]:
    """The rows that belong to actions: all but the last."""
    return _array(values)[:-1]


def _array(values: h5py.Dataset) -> NDArray[Any]:
    """The numbers of a dataset, one row per step at least."""
    array = np.asarray(values[()])
    if array.ndim == 0:
        raise TypeError(f"{values.name} holds one value in place of an array")
    return array


def _last_flag(values: h5py.Dataset) -> bool:
    """The last of the flags."""
    flags = _array(values)
    if flags.dtype != np.bool_ or flags.ndim != 1:
        raise TypeError(f"{values.name} has shape {flags.shape} and type {flags.dtype} in place of flags")
    return bool(flags[-1])


def _mapping(text: str | bytes, may_be_none: bool = False) -> Any:
    """The object in JSON text."""
    value = json.loads(text)
    if not isinstance(value, dict) and not (may_be_none and value is None):
        raise TypeError(f"the text {text!r} is no JSON object")
    return value


def _names(file: h5py.File, names: str, indices: str) -> tuple[str, ...]:
    """The skill or phase of every action; all names are used, and negative indices do not count from the end."""
    known, rows = [name.decode() for name in file[names][()]], _of_actions(file[indices])
    if set(rows.tolist()) != set(range(len(known))):
        raise IndexError(f"{indices} has indices {sorted(set(rows.tolist()))} among {len(known)} names")
    return tuple(known[index] for index in rows)
