"""Paths near a table: poses whose wrist would be inside the table have no base."""

import numpy as np
import pytest

from assets.robots import FETCH
from irm import FreeSpace, InverseReachabilityMap, SolidBoxes, Status, cached_map

PATH = [(-0.10, 0, 0), (-0.05, 0, 0), (0, 0, 0), (0, 0, 0.05), (0, 0, 0.10)]
TABLE = SolidBoxes.of(FETCH, [(0.0, 0.0, 0.73, 0.7, 1.0, 0.04)])
FLOOR = FreeSpace.from_boxes([(0.0, 0.0, 0.7, 1.0)], radius=0.31)


@pytest.fixture(scope="module")
def inverse_map():
    return InverseReachabilityMap(cached_map(FETCH))


def ask(inverse_map, height, solids, **more):
    how = {"pitch": -0.2, "yaw_range": (-0.1, 0.1), "free_space": FLOOR, "k": 3}
    return inverse_map.query_path(PATH, target=(0.0, 0.0, 0.75 + height), solids=solids, **how, **more)


def test_a_wrist_in_the_table_has_no_base(inverse_map):
    assert ask(inverse_map, 0.07, None).status is Status.YES
    low = ask(inverse_map, 0.07, TABLE)
    assert low.status is Status.NO
    assert len(low) == 0


def test_a_wrist_above_the_table_changes_nothing(inverse_map):
    plain, high = ask(inverse_map, 0.2, None), ask(inverse_map, 0.2, TABLE)
    assert high.status is Status.YES
    np.testing.assert_array_equal(plain.poses, high.poses)
    np.testing.assert_array_equal(plain.certain, high.certain)


def test_waypoints_in_the_world_are_tested_too(inverse_map):
    points = [(0.0, 0.0, 0.82), (0.0, 0.0, 0.87)]
    how = {"pitch": -0.2, "yaw_range": (-0.1, 0.1), "free_space": FLOOR}
    assert inverse_map.query_path(points, **how).status is Status.YES
    assert inverse_map.query_path(points, solids=TABLE, **how).status is Status.NO
