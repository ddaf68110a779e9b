"""Maps kept in the user's cache directory."""

import dataclasses
import logging

import numpy as np
import pytest

from assets.robots import FETCH
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


@pytest.mark.parametrize("content", [b"", b"rubbish", None])
def test_a_damaged_file_is_replaced(content, caplog):
    first = cached_map(FETCH, **SMALL)
    file = cache_file(FETCH, **SMALL)
    file.write_bytes(file.read_bytes()[:500] if content is None else content)
    with caplog.at_level(logging.WARNING):
        again = cached_map(FETCH, **SMALL)
    assert "built again" in caplog.text
    np.testing.assert_array_equal(again.cells, first.cells)
    assert len(ReachabilityMap.load(file, FETCH)) == len(first)


def test_a_cache_that_cannot_be_written_is_no_obstacle(monkeypatch, tmp_path, caplog):
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv("CLUTTER_ENV_CACHE", str(tmp_path / "file"))
    with caplog.at_level(logging.WARNING):
        assert len(cached_map(FETCH, **SMALL))
    assert "could not be kept" in caplog.text
