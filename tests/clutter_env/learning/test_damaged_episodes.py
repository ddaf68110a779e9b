"""Damaged episode files: always a DatasetError that names the file."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("h5py")
import h5py

from clutter_env.data.episode import record
from clutter_env.data.episode_file import read_episode, write_episode
from clutter_env.errors import DatasetError
from clutter_env.policies.experts import make_expert
from clutter_env.task import Task

PICK = Task("clutter_env/Pick-v0")


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file that can be read."""
    env = PICK.make()
    path = tmp_path_factory.mktemp("episodes") / "good.hdf5"
    write_episode(path, record(PICK, env, make_expert(env), seed=3))
    assert len(read_episode(path)) > 10
    return path


def places(path: Path) -> list[str]:
    """All groups and datasets of the file."""
    with h5py.File(path, "r") as file:
        names: list[str] = []
        file.visit(names.append)
        return names


def refused(path: Path) -> None:
    with pytest.raises(DatasetError, match=path.name):
        read_episode(path)


def test_truncated_files(good: Path, tmp_path: Path) -> None:
    content = good.read_bytes()
    for size in (0, 1, 100, len(content) // 2, len(content) - 1):
        path = tmp_path / f"{size}.hdf5"
        path.write_bytes(content[:size])
        refused(path)


def test_other_bytes(tmp_path: Path) -> None:
    path = tmp_path / "random.hdf5"
    path.write_bytes(np.random.default_rng(0).bytes(20_000))
    refused(path)
    refused(tmp_path / "absent.hdf5")
    refused(tmp_path)


WRONG: dict[str, Callable[[str], object]] = {
    "text": lambda _: "text",
    "a number": lambda _: 3,
    "an empty array": lambda _: np.zeros((0, 0)),
    "three rows of text": lambda _: np.array([b"a", b"b", b"c"]),
    "complex numbers": lambda _: np.zeros((4, 3), complex),
}


@pytest.mark.parametrize("kind", [*WRONG, "nothing", "a group"])
def test_wrong_datasets(good: Path, tmp_path: Path, kind: str) -> None:
    for place in places(good):
        path = tmp_path / f"{place.replace('/', '_')}.hdf5"
        shutil.copy(good, path)
        with h5py.File(path, "r+") as file:
            del file[place]
            if kind == "a group":
                file.create_group(place)
            elif kind != "nothing":
                file[place] = WRONG[kind](place)
        if is_still_valid(place, kind):
            continue
        refused(path)


def is_still_valid(place: str, kind: str) -> bool:
    """A plan is any text, and an environment need not have a certain observation."""
    is_observation = place.startswith("observations/") and kind == "nothing"
    return is_observation or (place == "observations" and kind == "a group") or (place, kind) == ("expert/plan", "text")


@pytest.mark.parametrize("name", ["seed", "options", "task", "versions"])
@pytest.mark.parametrize("value", [None, "no JSON", "[]", 1.5j, np.zeros(3)])
def test_wrong_attributes(good: Path, tmp_path: Path, name: str, value: object) -> None:
    path = tmp_path / "wrong.hdf5"
    shutil.copy(good, path)
    with h5py.File(path, "r+") as file:
        del file.attrs[name]
        if value is not None:
            file.attrs[name] = value
    refused(path)


STEPWISE = ("is_success", "num_fallen", "num_disturbed", "state", "skill", "phase", "contact_object", "keyframe")


@pytest.mark.parametrize("place", ["actions", "rewards", *(f"infos/{name}" for name in STEPWISE)])
def test_other_numbers_of_steps(good: Path, tmp_path: Path, place: str) -> None:
    path = tmp_path / "short.hdf5"
    shutil.copy(good, path)
    with h5py.File(path, "r+") as file:
        values = file[place][()]
        del file[place]
        file[place] = values[:-1]
    refused(path)


def test_flipped_bytes(good: Path, tmp_path: Path) -> None:
    """A file with random damage is either read or refused, never anything else."""
    content, rng = good.read_bytes(), np.random.default_rng(1)
    path = tmp_path / "flipped.hdf5"
    for _ in range(100):
        damaged = bytearray(content)
        for place in rng.integers(len(content), size=20):
            damaged[place] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        with contextlib.suppress(DatasetError):
            read_episode(path)
