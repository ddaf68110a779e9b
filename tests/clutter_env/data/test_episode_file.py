"""Episode files: they give back what was written; damaged ones are always a DatasetError that names the file."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from clutter_env.data.episode import Episode
from clutter_env.data.episode_file import read_episode, write_episode
from clutter_env.errors import DatasetError


def refused(path: Path) -> None:
    with pytest.raises(DatasetError, match=path.name):
        read_episode(path)


def test_an_episode_survives_its_file(planned_episode: Episode, tmp_path: Path) -> None:
    write_episode(tmp_path / "e.hdf5", planned_episode)
    back = read_episode(tmp_path / "e.hdf5")
    for field in dataclasses.fields(Episode):
        before, after = getattr(planned_episode, field.name), getattr(back, field.name)
        if isinstance(before, np.ndarray):
            assert before.dtype == after.dtype
            assert before.tobytes() == after.tobytes()
        elif field.name == "observations":
            assert all(before[name].tobytes() == after[name].tobytes() for name in before)
        elif field.name == "labels":
            for name, values in vars(before).items():
                np.testing.assert_array_equal(getattr(after, name), values)
        else:
            assert before == after


def test_a_file_of_version_0_1_can_be_read(pick_file: Path, tmp_path: Path) -> None:
    path = shutil.copy(pick_file, tmp_path / "old.hdf5")
    with h5py.File(path, "r+") as file:
        del file.attrs["provenance"]
        file.attrs["versions"] = json.dumps({"mujoco": "3.1"})
    assert read_episode(path).provenance == {"packages": {"mujoco": "3.1"}}


def test_other_bytes_are_refused(pick_file: Path, tmp_path: Path) -> None:
    content = pick_file.read_bytes()
    pieces = [content[:size] for size in (0, 1, 100, len(content) // 2, len(content) - 1)]
    for piece in (*pieces, b"nothing", np.random.default_rng(0).bytes(20_000)):
        path = tmp_path / f"{len(piece)}.hdf5"
        path.write_bytes(piece)
        refused(path)
    refused(tmp_path / "absent.hdf5")
    refused(tmp_path)


ATTRIBUTES = ("seed", "options", "task", "provenance")
INFOS = ("is_success", "num_fallen", "num_disturbed", "state", "skill", "phase", "contact_object", "keyframe")
WRONG = {
    "text": "text",
    "a number": 3,
    "an empty array": np.zeros((0, 0)),
    "three rows of text": np.array([b"a", b"b", b"c"]),
    "complex numbers": np.zeros((4, 3), complex),
    "nothing": None,
    "a group": None,
}


def is_still_valid(place: str, kind: str) -> bool:
    """A plan is any text, an environment need not have a certain observation, and older files have no full states."""
    if (place, kind) == ("saved_states", "nothing"):
        return True
    is_observation = place.startswith("observations/") and kind == "nothing"
    return is_observation or (place == "observations" and kind == "a group") or (place, kind) == ("expert/plan", "text")


def test_wrong_datasets_are_refused(pick_file: Path, tmp_path: Path) -> None:
    with h5py.File(pick_file, "r") as file:
        places: list[str] = []
        file.visit(places.append)
    for number, place in enumerate(places):
        kinds = list(WRONG)[number % 2 :: 2]  # half of them, in turn
        for kind in kinds:
            path = tmp_path / "wrong.hdf5"
            shutil.copy(pick_file, path)
            with h5py.File(path, "r+") as file:
                del file[place]
                if kind == "a group":
                    file.create_group(place)
                elif kind != "nothing":
                    file[place] = WRONG[kind]
            if not is_still_valid(place, kind):
                refused(path)


def test_wrong_attributes_and_other_numbers_of_steps_are_refused(pick_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "wrong.hdf5"
    for name, value in itertools.product(ATTRIBUTES, (None, "no JSON", "[]", 1.5j, np.zeros(3))):
        shutil.copy(pick_file, path)
        with h5py.File(path, "r+") as file:
            del file.attrs[name]
            if value is not None:
                file.attrs[name] = value
        refused(path)
    for place in ("actions", "rewards", *(f"infos/{name}" for name in INFOS)):
        shutil.copy(pick_file, path)
        with h5py.File(path, "r+") as file:
            values = file[place][()]
            del file[place]
            file[place] = values[:-1]
        refused(path)


def test_a_file_with_random_damage_is_read_or_refused(pick_file: Path, tmp_path: Path) -> None:
    content, rng = pick_file.read_bytes(), np.random.default_rng(1)
    path = tmp_path / "flipped.hdf5"
    for _ in range(60):
        damaged = bytearray(content)
        for place in rng.integers(len(content), size=20):
            damaged[place] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        with contextlib.suppress(DatasetError):
            read_episode(path)
