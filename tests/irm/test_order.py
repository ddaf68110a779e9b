"""The order of bases: best μ first, as in the paper, against a list of all bases that is sorted by μ."""

import numpy as np
import pytest

from irm.answers import Status
from irm.errors import QueryError
from irm.inverse_map import ClassicalInverseReachabilityMap
from irm.query_keys import find_key
from irm.reachability_map import CERTAIN_IN_HEIGHT
from irm.rotations import wrap_to_pi

YAWS = np.arange(-180, 180, 15) * np.pi / 180


@pytest.fixture(scope="module")
def classical(coarse_map):
    return ClassicalInverseReachabilityMap(coarse_map)


def asked(rng, grid, count):
    """Random heights and pitches on and between the rings, and a limited or a full range of yaws."""
    for k in range(count):
        pitch = rng.choice(grid.orientations.pitch) if k % 2 else rng.uniform(-1.5, 1.5)
        low = rng.uniform(-np.pi, np.pi)
        yaws = (-np.pi, np.pi) if k % 3 == 0 else (low, low + rng.uniform(0.0, 2.0))
        place = (*rng.uniform((-0.35, -0.75), (0.35, 0.75)), rng.uniform(grid.bottom + 0.3, grid.top - 0.3))
        yield place, {"pitch": float(pitch), "yaw_range": yaws}


def listed(rm, point, pitch, yaw_range, floor):
    """μ, flags, x and y of every base on free floor, straight from the poses of the map, best μ first.

    Without `InverseReachabilityMap`, its table or its kernels: equation 3 turned back into the base pose of each."""
    grid, key = rm.grid, find_key(rm.grid, point[2], pitch, 0.0)
    x, y, z = rm.positions.T
    yaw, ring, _ = rm.yaw_pitch_roll.T
    mine = (np.abs(ring - grid.orientations.pitch[key.group]) < 1e-9) & (rm.manipulability > 0)
    mine &= np.floor((z - grid.bottom) / grid.thickness).astype(int) == key.layer
    x, y, yaw, mu, flags = x[mine], y[mine], yaw[mine], rm.manipulability[mine], rm.flags[mine]
    low, high = yaw_range
    if abs(grid.orientations.pitch[key.group]) > 1.5 or high - low > 6.28:
        approaches = low + (YAWS - YAWS[0])
    else:
        approaches = np.linspace(low, high, int(np.ceil((high - low) / np.radians(15) - 1e-9)) + 1)
    bases = []
    for approach in approaches:
        turn = approach - yaw  # of the base, so that the TCP has this approach yaw
        c, s = np.cos(turn), np.sin(turn)
        at_x, at_y = point[0] - c * x + s * y, point[1] - s * x - c * y
        free = floor.are_free(at_x, at_y)
        bases.append(np.column_stack([mu, flags, at_x, at_y, wrap_to_pi(turn)])[free])
    bases = np.concatenate(bases)
    return bases[np.argsort(-bases[:, 0], kind="stable")]


@pytest.mark.parametrize("which", ["proposed", "classical"])
def test_bases_come_in_the_order_of_a_list_that_is_sorted_by_mu(
    coarse_map, coarse_inverse, classical, table_floor, which
):
    inverse, rng, some = {"proposed": coarse_inverse, "classical": classical}[which], np.random.default_rng(11), 0
    for point, how in asked(rng, coarse_map.grid, 40 if which == "proposed" else 20):
        expected = listed(coarse_map, point, how["pitch"], how["yaw_range"], table_floor)
        found = inverse.query(point, free_space=table_floor, exact=False, k=5, separation=0.0, **how)
        assert len(found) == min(5, len(expected))
        assert np.all(np.diff(found.manipulability) <= 0)
        if len(expected):
            assert found.manipulability[0] == np.float32(expected[0, 0])
            some += not int(expected[0, 1]) & CERTAIN_IN_HEIGHT
    assert some > 1, "the best base is never one whose cell is not reached over its whole height: nothing was tested"


def test_both_equations_give_the_same_answers_as_they_come(coarse_map, coarse_inverse, classical, table_floor):
    """With default arguments, whatever was decided exactly."""
    found = 0
    for point, how in asked(np.random.default_rng(12), coarse_map.grid, 25):
        new, old = (one.query(point, free_space=table_floor, **how) for one in (coarse_inverse, classical))
        assert len(new) == len(old)
        np.testing.assert_array_equal(new.manipulability, old.manipulability)
        if len(new):
            assert new.status is old.status
            found += 1
    assert found > 12


def test_bases_that_reach_over_the_whole_height_of_their_cell_come_first_on_request(
    coarse_map, coarse_inverse, classical, table_floor
):
    differ = 0
    for point, how in asked(np.random.default_rng(11), coarse_map.grid, 40):
        expected = listed(coarse_map, point, how["pitch"], how["yaw_range"], table_floor)
        if not len(expected):
            continue
        whole = expected[:, 1].astype(int) & CERTAIN_IN_HEIGHT > 0
        first = expected[whole][0] if whole.any() else expected[0]
        is_other = first[0] < expected[0, 0]
        for one in (coarse_inverse, classical) if is_other else (coarse_inverse,):
            found = one.query(point, free_space=table_floor, exact=False, order="certainty", **how)
            assert found.manipulability[0] == np.float32(first[0])
        differ += is_other
    assert differ > 0


def test_an_unknown_order_is_refused(coarse_inverse):
    with pytest.raises(QueryError, match="'manipulability' or 'certainty'"):
        coarse_inverse.query((0.0, 0.0, 0.9), order="best")


@pytest.mark.parametrize("yaw_range", [(-np.pi, np.pi), (-0.4, 0.7)])
def test_a_batch_and_many_bases_keep_the_order(coarse_inverse, table_floor, cups, yaw_range):
    for order in ("manipulability", "certainty"):
        how = {"free_space": table_floor, "k": 40, "order": order}
        batch = coarse_inverse.query_batch(cups[:8], yaw_ranges=yaw_range, **how)
        for k, cup in enumerate(cups[:8]):
            single = coarse_inverse.query(cup, yaw_range=yaw_range, exact=False, **how)
            assert single.status is not Status.NO
            np.testing.assert_array_equal(batch.manipulability[k, : len(single)], single.manipulability)
        if order == "manipulability":
            assert not np.any(np.diff(batch.manipulability, axis=1) > 0)
