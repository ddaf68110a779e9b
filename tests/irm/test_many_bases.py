"""Many bases for one TCP pose, kernels that are compiled once, and proofs that there is no base."""

import numpy as np
import pytest

from irm import common_bases, inverse_map
from irm.answers import Status
from irm.common_bases import best_common_bases
from irm.free_space import FreeSpace
from irm.query_kernels import best_bases, best_bases_batch

POSITION = (0.0, 0.0, 0.9)
RANGES = [(-np.pi, np.pi), (-0.6, 0.9)]


def behind_an_edge(distance, deep=4.0):
    """Floor that ends at a straight edge at this distance from the origin; the base's centre may stand on the edge."""
    return FreeSpace.from_boxes([(deep / 2 - distance + 0.3, 0.0, deep, 9.0)], 0.3, (-3, -3, 3.5, 3))


@pytest.mark.parametrize("yaw_range", RANGES)
def test_as_many_bases_as_one_wants(level_inverse, table_floor, yaw_range):
    placement = level_inverse.query(POSITION, yaw_range=yaw_range, free_space=table_floor, k=20_000, separation=0)
    assert len(placement) > 1000
    assert not np.any(np.diff(placement.manipulability) > 0)
    assert len(np.unique(placement.poses[:, :2].round(7), axis=0)) == len(placement)


@pytest.mark.parametrize("yaw_range", RANGES)
def test_a_search_that_pauses_gives_the_same_bases(level_inverse, table_floor, yaw_range, monkeypatch):
    """A long search is a sequence of short ones, between which the interpreter handles Ctrl-C."""

    def answers():
        keywords = {"free_space": table_floor, "k": 40, "separation": 0.03}
        single = level_inverse.query(POSITION, yaw_range=yaw_range, **keywords)
        batch = level_inverse.query_batch([POSITION, (0.1, 0.2, 0.8)], yaw_ranges=yaw_range, **keywords)
        path = level_inverse.query_path([POSITION, (0.05, 0.0, 0.95)], yaw_range=yaw_range, **keywords)
        return single.poses, batch.poses, path.poses

    whole = answers()
    monkeypatch.setattr(inverse_map, "_ROWS_AT_A_TIME", 3)
    monkeypatch.setattr(common_bases, "_BASES_AT_A_TIME", 3)
    for one, other in zip(whole, answers(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_kernels_are_compiled_once_with_and_without_a_floor(coarse_inverse, table_floor):
    for floor in (None, table_floor):
        for yaw_range in RANGES:
            coarse_inverse.query(POSITION, yaw_range=yaw_range, free_space=floor)
            for positions in ([POSITION], [POSITION, POSITION]):
                coarse_inverse.query_batch(positions, yaw_ranges=yaw_range, free_space=floor)
            coarse_inverse.query_path([POSITION], yaw_range=yaw_range, free_space=floor)
    for kernel in (best_bases, best_bases_batch, best_common_bases):
        assert len(kernel.signatures) == 1


def test_a_batch_takes_a_range_for_each_query(level_inverse, table_floor):
    rng = np.random.default_rng(4)
    middle = rng.uniform(-3, 3, 50)
    ranges = np.column_stack([middle - 0.2, middle + rng.uniform(0.0, 1.0, 50)])
    positions = np.column_stack([rng.uniform(-0.3, 0.3, (50, 2)), rng.uniform(0.75, 1.0, 50)])
    batch = level_inverse.query_batch(positions, yaw_ranges=ranges, free_space=table_floor, k=3)
    for k in range(50):
        single = level_inverse.query(positions[k], yaw_range=tuple(ranges[k]), free_space=table_floor, k=3)
        np.testing.assert_array_equal(batch.poses[k, : batch.count[k]], single.poses)


def test_no_begins_where_the_bases_end(level_inverse):
    """Behind an edge, NO is said at most two voxels farther away than the last base."""
    distances = np.arange(0.9, 1.5, 0.02)
    answers = [level_inverse.query(POSITION, free_space=behind_an_edge(distance)) for distance in distances]
    last = max(d for d, answer in zip(distances, answers, strict=True) if len(answer))
    first = min(d for d, answer in zip(distances, answers, strict=True) if answer.status is Status.NO)
    assert last < first <= last + 0.1
    assert answers[-1].status is Status.NO


def test_targets_farther_apart_than_two_arms_have_no_common_base(coarse_inverse):
    targets = [(0.0, 0.0, 0.9), (6.6, 0.0, 0.9)]
    assert coarse_inverse.query_multi(targets).status is Status.NO
    assert coarse_inverse.query_path(targets).status is Status.NO
    assert coarse_inverse.query_multi([(0.0, 0.0, 0.9), (0.4, 0.0, 0.9)]).status is not Status.NO
