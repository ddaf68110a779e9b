"""One episode as one HDF5 file: the layout of a Minari episode, and further data that Minari does not need.

    observations/…  actions  rewards  terminations  truncations
    infos/{is_success, num_fallen, num_disturbed, state, skill, phase, contact_skill, contact_object, contact_base,
        contact_tcp, keyframe}
    saved_states  expert/{plan, report, skills, phases}  attributes: id, seed, total_steps, options, task, provenance

Observations and infos have a row for each of the T + 1 states, the others one for each of the T actions. What belongs
to an action (skill, phase, contact, keyframe) stands in the row of the state before it. The last row has none.
`infos/skill` and `infos/phase` hold indices into the names in `expert/skills` and `expert/phases`. Every array has the
attributes `about`, `names` and `units`: what a row is, and name and unit of each of its numbers. `saved_states` are the
bytes of the full states of all rows, joined and compressed. See `saved_state.join_states`.
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

from clutter_env.data.episode import CONTACT_SKILLS, Columns, Episode, StepLabels
from clutter_env.errors import DatasetError
from clutter_env.simulation.saved_state import join_states, split_states
from clutter_env.task import Task

_COMPRESSION: Mapping[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
_NUMBERS = "fiub"
"""NumPy's kinds of numbers: floating, signed, unsigned, bool."""
_STATES = (
    ("infos/is_success", "is_success", 1, "b"),
    ("infos/num_fallen", "num_fallen", 1, "iu"),
    ("infos/num_disturbed", "num_disturbed", 1, "iu"),
    ("infos/state", "states", 2, "f"),
)
"""Arrays with a row for each state: name in the file, attribute of `Episode`, dimensions, NumPy's kinds of numbers."""
_LABELS = (
    ("infos/contact_skill", "skill", 1, "i", 0),
    ("infos/contact_object", "object", 1, "i", -1),
    ("infos/contact_base", "contact_base", 2, "f", np.nan),
    ("infos/contact_tcp", "contact_tcp", 3, "f", np.nan),
    ("infos/keyframe", "keyframe", 2, "f", np.nan),
)
"""Arrays with a row for each action: the same for `StepLabels`, and the value in the row of the last state."""
SAVED_STATES = "saved_states"
"""Name of the joined full states in the file."""
_SAVED_FORMAT = (
    "bytes of clutter_env.simulation.saved_state.join_states: a state of every row, for reset's option 'state'"
)
_TEXT = h5py.string_dtype(encoding="utf-8")


def write_episode(path: Path, episode: Episode) -> None:
    """Write the file.

    Raises:
        OSError: the disk is full or cannot be written.
    """
    with h5py.File(path, "w") as file:
        file.attrs.update(
            {
                "id": 0,
                "seed": episode.seed,
                "total_steps": len(episode),
                "options": json.dumps(episode.options),
                "task": episode.task.to_json(),
                "provenance": json.dumps(dict(episode.provenance)),
            }
        )
        for name, values in episode_arrays(episode).items():
            dataset = file.create_dataset(name, data=values, chunks=True, **_COMPRESSION)
            columns = episode.columns[name]
            dataset.attrs["about"] = columns.about
            for key, words in (("names", columns.names), ("units", columns.units)):
                dataset.attrs.create(key, list(words), dtype=_TEXT, shape=(len(words),))
        if episode.saved_states:
            joined = np.frombuffer(join_states(episode.saved_states), np.uint8)
            file.create_dataset(SAVED_STATES, data=joined).attrs["format"] = _SAVED_FORMAT
        file.create_dataset("expert/plan", data=episode.plan, dtype=_TEXT)
        file.create_dataset("expert/report", data=json.dumps(dict(episode.report)), dtype=_TEXT)
        file.create_dataset("expert/skills", data=sorted(set(episode.skills)), dtype=_TEXT)
        file.create_dataset("expert/phases", data=sorted(set(episode.labels.phases)), dtype=_TEXT)


def episode_arrays(episode: Episode) -> dict[str, NDArray[Any]]:
    """All arrays of an episode by their names in the file."""
    ends = np.zeros((2, len(episode)), dtype=bool)
    ends[:, -1] = episode.terminated, episode.truncated
    arrays: dict[str, NDArray[Any]] = {f"observations/{name}": value for name, value in episode.observations.items()}
    arrays |= {"actions": episode.actions, "rewards": episode.rewards, "terminations": ends[0], "truncations": ends[1]}
    arrays |= {name: getattr(episode, attribute) for name, attribute, *_ in _STATES}
    for name, names in (("infos/skill", episode.skills), ("infos/phase", episode.labels.phases)):
        known = sorted(set(names))
        arrays[name] = _with_last_row(np.array([known.index(entry) for entry in names], np.int64), -1)
    for name, attribute, _, _, none in _LABELS:
        arrays[name] = _with_last_row(getattr(episode.labels, attribute), none)
    return arrays


def read_episode(path: Path) -> Episode:
    """Read the episode in a file. Files of version 0.1 can be read too.

    Raises:
        DatasetError: the file is missing or damaged, or it holds no episode.
    """
    try:
        with h5py.File(path, "r") as file:
            episode = _read(file)
        wrong = _wrong_entry(episode)
    # Damaged files make HDF5 and NumPy raise all of these. MemoryError comes from absurd sizes.
    except (
        OSError,
        RuntimeError,
        ArithmeticError,
        LookupError,
        TypeError,
        ValueError,
        AttributeError,
        MemoryError,
    ) as problem:
        wrong = str(problem) or type(problem).__name__
    if wrong:
        raise DatasetError(f"{path} holds no episode of this package, or it is damaged: {wrong}")
    return episode


def _read(file: h5py.File) -> Episode:
    attributes = file.attrs
    recorded = attributes.get("provenance")
    return Episode(
        task=Task.from_json(attributes["task"]),
        seed=operator.index(attributes["seed"]),
        options=_mapping(attributes["options"], may_be_none=True),
        observations={name: _array(values) for name, values in file["observations"].items()},
        actions=_array(file["actions"]),
        rewards=_array(file["rewards"]),
        terminated=_last_flag(file["terminations"]),
        truncated=_last_flag(file["truncations"]),
        **{attribute: _array(file[name]) for name, attribute, *_ in _STATES},
        skills=_names(file, "expert/skills", "infos/skill"),
        labels=StepLabels(
            _names(file, "expert/phases", "infos/phase"),
            **{attribute: _array(file[name])[:-1] for name, attribute, *_ in _LABELS},
        ),
        columns=_read_columns(file),
        plan=file["expert/plan"][()].decode(),
        report=_mapping(file["expert/report"][()]),
        # Version 0.1 stored only the versions of the packages.
        provenance={"packages": _mapping(attributes["versions"])} if recorded is None else _mapping(recorded),
        saved_states=split_states(bytes(_array(file[SAVED_STATES]))) if SAVED_STATES in file else (),
    )


def _wrong_entry(episode: Episode) -> str:
    """Description of an inconsistency in an episode of T actions, "" without any."""
    steps = len(episode)
    expected: list[tuple[str, NDArray[Any], int, int, str]] = [
        ("actions", episode.actions, steps, 2, "f"),
        ("rewards", episode.rewards, steps, 1, "f"),
        *((name, getattr(episode, of), steps + 1, ndim, kinds) for name, of, ndim, kinds in _STATES),
        *((name, getattr(episode.labels, of), steps, ndim, kinds) for name, of, ndim, kinds, _ in _LABELS),
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
    if len(episode.saved_states) not in (0, steps + 1):
        return f"{SAVED_STATES} has {len(episode.saved_states)} states for {steps} actions"
    if not np.isin(episode.labels.skill, np.arange(len(CONTACT_SKILLS))).all():
        return f"infos/contact_skill has numbers other than 0 to {len(CONTACT_SKILLS) - 1}"
    return ""


def _with_last_row(rows: NDArray[Any], none: float) -> NDArray[Any]:
    """Rows of the actions, and a row for the last state, which has no action."""
    return np.concatenate((rows, np.full((1, *rows.shape[1:]), none, rows.dtype)))


def _read_columns(file: h5py.File) -> dict[str, Columns]:
    """Names and units of all arrays that have them."""
    found: dict[str, Columns] = {}

    def read(name: str, entry: h5py.Group | h5py.Dataset) -> None:
        if isinstance(entry, h5py.Dataset) and "about" in entry.attrs:
            about, names, units = (entry.attrs[key] for key in ("about", "names", "units"))
            found[name] = Columns(str(about), tuple(map(str, names)), tuple(map(str, units)))

    file.visititems(read)
    return found


def _array(values: h5py.Dataset) -> NDArray[Any]:
    """Numbers of a dataset, at least one row per step."""
    array = np.asarray(values[()])
    if array.ndim == 0:
        raise TypeError(f"{values.name} holds one value in place of an array")
    return array


def _last_flag(values: h5py.Dataset) -> bool:
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
    """Skill or phase of every action. All names must be used, and negative indices are invalid."""
    known, rows = [name.decode() for name in file[names][()]], _array(file[indices])[:-1]
    if set(rows.tolist()) != set(range(len(known))):
        raise IndexError(f"{indices} has indices {sorted(set(rows.tolist()))} among {len(known)} names")
    return tuple(known[index] for index in rows)
