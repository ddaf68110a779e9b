"""The planner's reachability map comes with the package."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import assets
from assets.robots import FETCH
from irm import ReachabilityMap, cached_map
from irm.reachability_map import cache_file, is_map_at_hand, shipped_file
from planners.grasping.base_placement import map_parameters


def test_it_is_loaded_and_not_built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The name of the file contains a digest of robot, parameters and format: after a change, ship another file."""
    monkeypatch.setenv("CLUTTER_ENV_CACHE", str(tmp_path))
    monkeypatch.setattr(ReachabilityMap, "build", None)
    assert is_map_at_hand(FETCH, **map_parameters(FETCH))
    assert len(cached_map(FETCH, **map_parameters(FETCH))) > 100_000
    assert not cache_file(FETCH, **map_parameters(FETCH)).exists()


def test_no_other_map_is_shipped() -> None:
    assert list(assets.folder("maps").iterdir()) == [shipped_file(FETCH, **map_parameters(FETCH))]


@pytest.mark.slow
def test_it_is_what_is_built() -> None:
    shipped = ReachabilityMap.load(shipped_file(FETCH, **map_parameters(FETCH)), FETCH)
    built = ReachabilityMap.build(FETCH, **map_parameters(FETCH))
    assert shipped.key == built.key
    for name in ("cells", "manipulability", "torso_index", "flags"):
        np.testing.assert_array_equal(getattr(shipped, name), getattr(built, name), err_msg=name)
