"""Map files from the cache and from anywhere: one clear error each, and a bad cache is rebuilt."""

from __future__ import annotations

import dataclasses
import io
import json
import logging
import zipfile

import numpy as np
import pytest

from assets.robots import FETCH
from irm.errors import MapFileError, ReachabilityError
from irm.reachability_map import ReachabilityMap, cache_file, cached_map

SMALL = {"voxel": 0.25, "orientations": 6}


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("CLUTTER_ENV_CACHE", str(tmp_path))


def test_a_map_is_built_once(monkeypatch):
    first = cached_map(FETCH, **SMALL)
    assert cache_file(FETCH, **SMALL).is_file()
    monkeypatch.setattr(ReachabilityMap, "build", None)
    np.testing.assert_array_equal(cached_map(FETCH, **SMALL).cells, first.cells)


def test_robot_and_parameters_have_files_of_their_own():
    other = dataclasses.replace(FETCH, tcp_offset=(0.2, 0.0, 0.0))
    files = {cache_file(FETCH, **SMALL), cache_file(other, **SMALL), cache_file(FETCH, voxel=0.2, orientations=6)}
    assert len(files) == 3


@pytest.mark.parametrize(
    "damage", [lambda _: b"", lambda _: b"rubbish", lambda b: b[:500], lambda b: b[:300] + bytes(99)]
)
def test_a_damaged_file_is_refused_and_replaced(damage, caplog):
    first = cached_map(FETCH, **SMALL)
    file = cache_file(FETCH, **SMALL)
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(MapFileError, match="build it again"):
        ReachabilityMap.load(file, FETCH)
    with caplog.at_level(logging.WARNING):
        again = cached_map(FETCH, **SMALL)
    assert "built again" in caplog.text
    np.testing.assert_array_equal(again.cells, first.cells)
    assert len(ReachabilityMap.load(file, FETCH)) == len(first)
    with pytest.raises(FileNotFoundError):
        ReachabilityMap.load(file.with_name("none.npz"), FETCH)


def test_a_cache_that_cannot_be_written_is_no_obstacle(monkeypatch, tmp_path, caplog):
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv("CLUTTER_ENV_CACHE", str(tmp_path / "file"))
    with caplog.at_level(logging.WARNING):
        assert len(cached_map(FETCH, **SMALL))
    assert "could not be kept" in caplog.text


@pytest.fixture(scope="module")
def members(tmp_path_factory):
    """The files inside a map file."""
    path = tmp_path_factory.mktemp("map") / "map.npz"
    ReachabilityMap.build(FETCH, **SMALL).save(path)
    with zipfile.ZipFile(path) as file:
        return {name: file.read(name) for name in file.namelist()}


def npy(array):
    content = io.BytesIO()
    np.save(content, array)
    return content.getvalue()


def with_header(shape, kind="<u4"):
    """A .npy file that promises an array of some shape, and contains four bytes."""
    content = io.BytesIO()
    np.lib.format.write_array_header_1_0(content, {"descr": kind, "fortran_order": False, "shape": shape})
    return content.getvalue() + bytes(4)


def about(members, **changes):
    description = json.loads(str(np.load(io.BytesIO(members["about.npy"]))))
    return npy(np.array(json.dumps(description | changes)))


def parameters(members, **changes):
    description = json.loads(str(np.load(io.BytesIO(members["about.npy"]))))
    return about(members, parameters=description["parameters"] | changes)


def changed(members, name, index, value):
    array = np.load(io.BytesIO(members[f"{name}.npy"])).copy()
    array[index] = value
    return npy(array)


CRAFTED = {
    "deep JSON": lambda _: {"about.npy": npy(np.array("[" * 100_000))},
    "JSON that is no description": lambda _: {"about.npy": npy(np.array("[1, 2]"))},
    "no robot": lambda m: {"about.npy": about(m, robot=3)},
    "no key": lambda m: {"about.npy": about(m, key=None)},
    "one height": lambda m: {"about.npy": parameters(m, heights=[1.0])},
    "three heights": lambda m: {"about.npy": parameters(m, heights=[0.0, 1.0, 2.0])},
    "heights as text": lambda m: {"about.npy": parameters(m, heights="high")},
    "pitches in lists": lambda m: {"about.npy": parameters(m, pitches=[[0.0]])},
    "voxel as text": lambda m: {"about.npy": parameters(m, voxel="small")},
    "orientations as list": lambda m: {"about.npy": parameters(m, orientations=[6])},
    "4 TB": lambda _: {"codes.npy": with_header((1_000_000_000_000,))},
    "more than 64 bits": lambda _: {"codes.npy": with_header((2**62, 16))},
    "negative shape": lambda _: {"codes.npy": with_header((-1,))},
    "objects": lambda _: {"codes.npy": with_header((1,), "|O")},
    "another kind": lambda _: {"codes.npy": npy(np.zeros(3))},
    "torso index": lambda m: {"codes.npy": changed(m, "codes", 0, 3)},
    "level": lambda m: {"codes.npy": changed(m, "codes", 0, 2**32 - 1)},
    "a cell too many": lambda m: {"free.npy": changed(m, "free", slice(None), 255)},
    "a cell outside": lambda m: {"reached.npy": changed(m, "reached", slice(None), 255)[:-8]},
    "a code too few": lambda m: {"codes.npy": npy(np.load(io.BytesIO(m["codes.npy"]))[1:])},
    "order": lambda m: {"levels.npy": changed(m, "levels", 5, 0)},
    "manipulability": lambda m: {"levels.npy": changed(m, "levels", 0, np.nan)},
}


@pytest.mark.parametrize("kind", CRAFTED)
def test_a_crafted_file_gives_one_clear_error_and_a_bad_cache_is_rebuilt(kind, members, tmp_path, monkeypatch):
    monkeypatch.setenv("CLUTTER_ENV_CACHE", str(tmp_path))
    path = cache_file(FETCH, **SMALL)
    with zipfile.ZipFile(path, "w") as file:
        for name, content in (members | CRAFTED[kind](members)).items():
            file.writestr(name, content)
    with pytest.raises(MapFileError, match=str(path)):
        ReachabilityMap.load(path, FETCH)
    assert len(cached_map(FETCH, **SMALL))
    assert len(ReachabilityMap.load(path, FETCH))


@pytest.mark.parametrize("extent", [{"half": 10**6}, {"layers": -1}, {"centre": [0.0]}, {"bottom": "low"}, 3])
def test_a_crafted_grid_is_refused(extent, tmp_path):
    path = tmp_path / "map.npz"
    ReachabilityMap.from_poses(np.eye(4)[None], [0.1], orientations=6).save(path)
    with zipfile.ZipFile(path) as file:
        members = {name: file.read(name) for name in file.namelist()}
    grid = json.loads(str(np.load(io.BytesIO(members["about.npy"]))))["grid"]
    members["about.npy"] = about(members, grid=grid | extent if isinstance(extent, dict) else extent)
    with zipfile.ZipFile(path, "w") as file:
        for name, content in members.items():
            file.writestr(name, content)
    with pytest.raises(MapFileError, match="no valid grid"):
        ReachabilityMap.load(path)


def test_a_map_that_no_memory_holds_is_refused_before_it_is_built():
    with pytest.raises(ReachabilityError, match=r"needs .* GiB; at most"):
        ReachabilityMap.build(FETCH, voxel=0.005)
