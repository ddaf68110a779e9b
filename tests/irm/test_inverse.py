"""Both inverse maps, and the compiled query against plain NumPy."""

import numpy as np
import pytest

from irm.answers import Status
from irm.errors import QueryError
from irm.free_space import FreeSpace
from irm.inverse_map import ClassicalInverseReachabilityMap, inverse_reachability
from irm.inverse_table import inverse_reachability_on_floor
from irm.rotations import rotation, rotations
from irm.verification import tcp_poses
from scripts.map_speed import full_scan
from tests.irm.arms import in_base, is_reached


def reaches(base, position, yaw, pitch=0.0, torsos=60):
    """Exact: does any configuration reach the TCP pose from this base? The roll is free."""
    return is_reached(in_base(base, tcp_poses(position, yaw, pitch)[0]), torsos, 721)


def best(placement):
    return float(placement.manipulability[0]) if len(placement) else 0.0


@pytest.mark.parametrize("yaw_range", [(-np.pi, np.pi), (-np.pi / 2, np.pi / 2), (2.9, 3.6), (0.3, 0.3)])
@pytest.mark.parametrize("pitch", [0.0, np.radians(30), np.radians(-40), np.pi / 2])
def test_equations_4_and_5_and_the_compiled_query_agree(
    coarse_map, coarse_inverse, table_floor, cups, pitch, yaw_range
):
    classical = ClassicalInverseReachabilityMap(coarse_map)
    for cup in cups[:4]:
        keywords = {"pitch": pitch, "yaw_range": yaw_range, "free_space": table_floor}
        proposed = coarse_inverse.query(cup, **keywords)
        assert best(full_scan(coarse_inverse, cup, **keywords)) == best(proposed)
        assert best(classical.query(cup, **keywords)) == best(proposed)


def test_several_bases_are_the_same_by_both_equations(coarse_map, coarse_inverse, table_floor, cups):
    classical = ClassicalInverseReachabilityMap(coarse_map)
    for cup in cups[:5]:
        keywords = {"yaw_range": (-1.0, 1.0), "free_space": table_floor, "k": 4, "separation": 0.0}
        a, b = coarse_inverse.query(cup, **keywords), classical.query(cup, **keywords)
        np.testing.assert_allclose(a.manipulability, b.manipulability)
        assert a.status is b.status


def test_bases_are_free_apart_sorted_and_read_only(level_inverse, table_floor, cups):
    for cup in cups:
        placement = level_inverse.query(cup, free_space=table_floor, k=6, separation=0.15)
        assert len(placement) == 6
        assert all(table_floor.is_free(x, y) for x, y, _ in placement.poses)
        assert np.all(np.diff(placement.manipulability) <= 0)
        apart = np.linalg.norm(placement.poses[:, None, :2] - placement.poses[None, :, :2], axis=2)
        assert apart[~np.eye(6, dtype=bool)].min() > 0.15
        assert np.all(np.abs(placement.poses[:, 2]) <= np.pi)
        for array in (placement.poses, placement.manipulability, placement.torso, placement.certain):
            assert not array.flags.writeable


def test_certain_bases_reach_exactly_with_the_torso_given(level_inverse, table_floor, cups):
    certain = 0
    for cup in cups[:30]:
        placement = level_inverse.query(cup, yaw_range=(-1.5, 1.5), free_space=table_floor, k=3)
        for k in range(len(placement)):
            if placement.certain[k]:
                assert reaches(placement.poses[k], cup, placement.approach_yaw[k])
                certain += 1
    assert certain > 60


def test_an_entirely_turned_world_gives_entirely_turned_bases(level_inverse, cups):
    placement = level_inverse.query(cups[0], yaw_range=(0.2, 0.2), k=3)
    turn = 1.1
    c, s = np.cos(turn), np.sin(turn)
    turned = level_inverse.query(
        [c * cups[0][0] - s * cups[0][1], s * cups[0][0] + c * cups[0][1], cups[0][2]],
        yaw_range=(0.2 + turn, 0.2 + turn),
        k=3,
    )
    x, y, yaw = placement.poses.T
    expected = np.column_stack([c * x - s * y, s * x + c * y, yaw + turn])
    np.testing.assert_allclose(turned.poses[:, :2], expected[:, :2], atol=1e-6)
    np.testing.assert_allclose(np.cos(turned.poses[:, 2] - expected[:, 2]), 1.0, atol=1e-9)


def test_a_batch_gives_what_single_queries_give(level_inverse, table_floor, cups):
    batch = level_inverse.query_batch(cups, yaw_ranges=(-1.2, 0.9), free_space=table_floor, k=3)
    for k, cup in enumerate(cups):
        single = level_inverse.query(cup, yaw_range=(-1.2, 0.9), free_space=table_floor, k=3)
        assert batch.count[k] == len(single)
        np.testing.assert_array_equal(batch.poses[k, : len(single)], single.poses)
        np.testing.assert_array_equal(batch.certain[k, : len(single)], single.certain)
        assert np.isnan(batch.poses[k, len(single) :]).all()


@pytest.mark.slow
def test_narrow_strips_of_floor_are_not_lost(level_inverse):
    rng = np.random.default_rng(3)
    found = 0
    for _ in range(40):
        width, turn = rng.uniform(0.05, 0.1), rng.uniform(-np.pi, np.pi)
        away = rng.uniform(0.45, 0.95)
        c, s = np.cos(turn), np.sin(turn)
        near, far = away - 2.0, away + width + 2.0
        walls = [(c * near, s * near, 4.0 - 0.6, 9.0, turn), (c * far, s * far, 4.0 - 0.6, 9.0, turn)]
        strip = FreeSpace.from_boxes(walls, 0.3, (-2.5, -2.5, 2.5, 2.5))
        cup = [0.0, 0.0, rng.uniform(0.75, 1.1)]
        scan, fast = full_scan(level_inverse, cup, free_space=strip), level_inverse.query(cup, free_space=strip)
        assert best(scan) == best(fast)
        found += len(fast)
    assert found > 20


def test_no_is_said_when_nothing_is_free_or_all_is_out_of_reach(level_inverse, coarse_inverse):
    walled = FreeSpace.from_boxes([(0.0, 0.0, 8.0, 8.0)], 0.3, (-2, -2, 2, 2))
    assert level_inverse.query([0, 0, 0.9], free_space=walled).status is Status.NO
    far = FreeSpace.from_boxes([(0.0, 0.0, 3.6, 3.6)], 0.3, (-4, -4, 4, 4))
    assert level_inverse.query([0, 0, 0.9], free_space=far).status is Status.NO
    assert coarse_inverse.query([0, 0, 2.9]).status is Status.NO
    assert coarse_inverse.query([0, 0, 0.9]).status is Status.YES
    behind = FreeSpace.from_boxes([(-3.0, 0.0, 4.0, 8.0)], 0.3, (-4, -4, 4, 4))
    assert coarse_inverse.query([-2.0, 0.0, 0.9], yaw_range=(0, 0), free_space=behind).status is Status.NO


@pytest.mark.slow
def test_no_is_never_wrong(coarse_inverse):
    """Where NO is said, no base on a fine lattice of the free floor reaches, whatever its yaw."""
    rng = np.random.default_rng(5)
    said = 0
    for _ in range(60):
        edge, yaw = rng.uniform(-1.9, -0.2), rng.uniform(-3, 3)
        floor = FreeSpace.from_boxes([(edge + 2.3, 0.0, 4.0, 9.0)], 0.3, (-2, -1.5, 2, 1.5))
        cup = np.array([0.0, rng.uniform(-0.3, 0.3), rng.uniform(0.1, 1.6)])
        if coarse_inverse.query(cup, yaw_range=(yaw, yaw), free_space=floor).status is not Status.NO:
            continue
        said += 1
        for _ in range(25):
            x, y, base_yaw = rng.uniform([edge - 0.3, -1.3, -np.pi], [edge, 1.3, np.pi])
            assert not (floor.is_free(x, y) and reaches((x, y, base_yaw), cup, yaw, torsos=5))
    assert said > 5


def test_a_vertical_approach_leaves_the_base_free_to_stand_all_around(coarse_inverse):
    ranges = [(0.0, 0.0), (1.0, 2.0), (-np.pi, np.pi)]
    found = [coarse_inverse.query([0, 0, 0.9], pitch=np.pi / 2, yaw_range=bounds) for bounds in ranges]
    assert len({float(placement.manipulability[0]) for placement in found}) == 1
    base = found[0].poses[0]
    assert reaches(base, [0, 0, 0.9], 0.0, np.pi / 2)


@pytest.mark.parametrize(
    ("position", "keywords", "message"),
    [
        ([np.nan, 0, 0.9], {}, "three finite numbers"),
        ([0, 0.9], {}, "three finite numbers"),
        ("here", {}, "three finite numbers"),
        ([0, 0, 0.9], {"yaw_range": (1.0, 0.5)}, "is empty"),
        ([0, 0, 0.9], {"yaw_range": (np.nan, 0.5)}, "finite"),
        ([0, 0, 0.9], {"yaw_range": (0, 7.0)}, "longer than"),
        ([0, 0, 0.9], {"yaw_range": 0.5}, "pair of numbers"),
        ([0, 0, 0.3], {}, r"covers TCP heights 0\.69 to 1\.24"),
        ([0, 0, 0.9], {"pitch": 0.5}, r"rings at 0\.0"),
        ([0, 0, 0.9], {"pitch": 2.0}, r"\[-π/2, π/2\]"),
    ],
)
def test_queries_without_meaning_are_refused(level_inverse, position, keywords, message):
    with pytest.raises(QueryError, match=message):
        level_inverse.query(position, **keywords)


def test_free_space_that_excludes_everything_leaves_nothing(coarse_map, coarse_inverse):
    walled = FreeSpace.from_boxes([(0.0, 0.0, 8.0, 8.0)], 0.3, (-2, -2, 2, 2))
    position = (0.0, 0.0, 0.9)
    for narrow in ((-np.pi, np.pi), (0.0, 0.5)):
        assert coarse_inverse.query(position, yaw_range=narrow, free_space=walled).status is Status.NO
        classical = ClassicalInverseReachabilityMap(coarse_map)
        assert classical.query(position, yaw_range=narrow, free_space=walled).status is Status.NO
        assert len(full_scan(coarse_inverse, position, yaw_range=narrow, free_space=walled)) == 0
        batch = coarse_inverse.query_batch(np.tile(position, (3, 1)), yaw_ranges=narrow, free_space=walled)
        assert not batch.count.any()
        assert np.isnan(batch.poses).all()


def pose(R, p):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


def test_equation_4_is_the_inverse_transform():
    rng = np.random.default_rng(0)
    R, p = rotations(*rng.uniform(-1.5, 1.5, (3, 20))), rng.normal(size=(20, 3))
    for T_base_tcp, R_base, p_base in zip(map(pose, R, p), *inverse_reachability(R, p), strict=True):
        np.testing.assert_allclose(T_base_tcp @ pose(R_base, p_base), np.eye(4), atol=1e-12)


def test_equation_5_puts_the_base_where_the_tcp_has_yaw_0_and_the_origin_of_the_floor():
    """T_world_base @ T_base_tcp has the TCP above the origin, with its height, pitch and roll, and yaw 0."""
    rng = np.random.default_rng(1)
    x, y, z, yaw, pitch, roll = rng.uniform(-1.5, 1.5, (6, 20))
    for k, base in enumerate(zip(*inverse_reachability_on_floor(x, y, yaw), strict=True)):
        T_world_base = pose(rotation(base[2], 0.0, 0.0), [base[0], base[1], 0.0])
        T_base_tcp = pose(rotation(yaw[k], pitch[k], roll[k]), [x[k], y[k], z[k]])
        expected = pose(rotation(0.0, pitch[k], roll[k]), [0.0, 0.0, z[k]])
        np.testing.assert_allclose(T_world_base @ T_base_tcp, expected, atol=1e-12)
