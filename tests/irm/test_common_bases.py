"""One base for a path, or for several targets; paths near a table."""

from __future__ import annotations

import numpy as np
import pytest

from assets.robots import FETCH
from irm import FreeSpace, InverseReachabilityMap, SolidBoxes, cached_map
from irm.answers import Status
from irm.errors import QueryError
from irm.grid import nearest_orientation
from irm.rotations import rotation
from tests.irm.arms import PATH, in_world


def mu_at(rm, base, position, yaw):
    """Slow reference: μ of the map for a level TCP in the frame of a base."""
    c, s = np.cos(base[2]), np.sin(base[2])
    dx, dy = position[0] - base[0], position[1] - base[1]
    grid = rm.grid
    i = int(np.floor((c * dx + s * dy - grid.centre[0]) / grid.voxel)) + grid.half
    j = int(np.floor((c * dy - s * dx - grid.centre[1]) / grid.voxel)) + grid.half
    o = nearest_orientation(grid.orientations, rotation(yaw - base[2], 0.0, 0.0)[None])[0]
    if not (0 <= i < grid.shape[2] and 0 <= j < grid.shape[3]):
        return 0.0
    cell = np.ravel_multi_index((grid.layer(position[2]), o, i, j), grid.shape)
    place = np.searchsorted(rm.cells, cell)
    return float(rm.manipulability[place]) if place < len(rm) and rm.cells[place] == cell else 0.0


def test_the_score_of_a_path_is_its_worst_waypoint(level_map, level_inverse, table_floor, cups):
    found = 0
    for cup in cups[:20]:
        placement = level_inverse.query_path(
            PATH, target=cup, yaw_range=(-1.2, 1.2), free_space=table_floor, k=3, exact=False
        )
        assert placement.approach_yaw.shape == (len(placement),)
        assert placement.torso.shape == (len(placement), len(PATH))
        assert np.all(np.diff(placement.manipulability) <= 0)
        for base, mu, yaw in zip(placement.poses, placement.manipulability, placement.approach_yaw, strict=True):
            scores = [mu_at(level_map, base, point, yaw) for point in in_world(cup, yaw)]
            assert mu == pytest.approx(min(scores))
            assert table_floor.is_free(*base[:2])
            found += 1
    assert found > 40


def test_waypoints_in_the_world_and_offsets_at_a_target_agree_at_one_yaw(level_inverse, table_floor, cups):
    for yaw in (0.0, 0.7):
        keywords = {"yaw_range": (yaw, yaw), "free_space": table_floor}
        a = level_inverse.query_path(PATH, target=cups[0], **keywords)
        b = level_inverse.query_path(in_world(cups[0], yaw), **keywords)
        np.testing.assert_allclose(a.poses, b.poses, atol=1e-9)
        np.testing.assert_allclose(a.torso, b.torso)


def test_every_one_of_several_targets_is_reached(level_map, level_inverse, table_floor, cups):
    found = 0
    for k in range(0, 30, 3):
        targets = cups[k : k + 3] * (1.0, 0.3, 1.0)
        windows = [(-1.2, 0.8), (-0.5, 1.5), (-1.5, 1.5)]
        placement = level_inverse.query_multi(targets, yaw_ranges=windows, free_space=table_floor, k=2)
        for base, mu, yaws in zip(placement.poses, placement.manipulability, placement.approach_yaw, strict=True):
            scores = [mu_at(level_map, base, point, yaw) for point, yaw in zip(targets, yaws, strict=True)]
            assert mu == pytest.approx(min(scores))
            assert all(low - 1e-4 <= yaw <= high + 1e-4 for yaw, (low, high) in zip(yaws, windows, strict=True))
            found += 1
    assert found > 10


def test_certain_paths_are_certain_at_every_waypoint(coarse_inverse, level_inverse, table_floor, cups):
    answers = [level_inverse.query_path(PATH, target=cup, free_space=table_floor, k=3) for cup in cups[:20]]
    assert any(answer.status is Status.YES for answer in answers)
    assert all((answer.status is Status.YES) == bool(answer.certain.any()) for answer in answers)
    vertical = [(0, 0, 0.1), (0, 0, 0)]
    assert len(coarse_inverse.query_path(vertical, target=(0, 0, 0.9), pitch=np.pi / 2)) == 1
    with pytest.raises(QueryError, match="no horizontal direction"):
        coarse_inverse.query_path(PATH, target=(0, 0, 0.9), pitch=np.pi / 2)


def test_misuse_is_refused(level_inverse):
    with pytest.raises(QueryError, match=r"\(n, 3\)"):
        level_inverse.query_path([], target=(0, 0, 0.9))
    for query in (level_inverse.query_batch, level_inverse.query_multi):
        with pytest.raises(QueryError, match="finite"):
            query([(0, 0, np.nan)])
        with pytest.raises(QueryError, match="do not go with"):
            query(np.full((3, 3), 0.9), yaw_ranges=np.zeros((2, 2)))


TABLE = SolidBoxes.of(FETCH, [(0.0, 0.0, 0.73, 0.7, 1.0, 0.04)])
FLOOR = FreeSpace.from_boxes([(0.0, 0.0, 0.7, 1.0)], radius=0.31)


def test_gripper_and_wrist_keep_out_of_a_table():
    """A rising approach: a low one has its wrist in the table, whatever the base is; a high one changes nothing."""
    inverse_map = InverseReachabilityMap(cached_map(FETCH))
    how = {"pitch": -0.2, "yaw_range": (-0.1, 0.1), "free_space": FLOOR, "k": 3}
    low = {"target": (0.0, 0.0, 0.82)}
    for points, more in ((PATH, low), ([(0.0, 0.0, 0.82), (0.0, 0.0, 0.87)], {})):
        assert inverse_map.query_path(points, **more, **how).status is Status.YES
        blocked = inverse_map.query_path(points, solids=TABLE, **more, **how)
        assert (blocked.status, len(blocked)) == (Status.NO, 0)
    plain, high = (
        inverse_map.query_path(PATH, target=(0.0, 0.0, 0.95), solids=solids, **how) for solids in (None, TABLE)
    )
    assert high.status is Status.YES
    np.testing.assert_array_equal(plain.poses, high.poses)
    np.testing.assert_array_equal(plain.certain, high.certain)
