"""Queries for sets of gripper poses: ranges of pitch, roll and height, several poses, limits on the base's yaw."""

import numpy as np
import pytest

from irm import ArmChain, QueryError
from irm.answers import Status
from irm.free_space import FreeSpace
from irm.ik.solvers import ExactSolver
from irm.inverse_map import ClassicalInverseReachabilityMap, InverseReachabilityMap
from irm.reachability_map import ReachabilityMap
from irm.rotations import rotation, wrap_to_pi
from irm.verification import tcp_poses
from tests.irm.arms import CHAIN, in_base
from tests.irm.test_standalone import TABLE

SOLVER = ExactSolver(CHAIN)
CUP = (0.1, -0.2, 0.85)
LONG = {"k": 400, "separation": 0.0, "exact": False}


def pose(point, yaw, pitch, roll=0.0):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation(yaw, pitch, roll), point
    return T


@pytest.mark.parametrize("yaw_range", [(-np.pi, np.pi), (-0.7, 0.2)])
def test_a_set_has_the_best_bases_of_all_its_rings_and_layers(coarse_inverse, table_floor, yaw_range):
    """Against one query for each ring and the middle of each layer in the ranges, put together and sorted by μ."""
    grid = coarse_inverse.reachability_map.grid
    pitch, height = (-0.1, np.pi / 2), (0.5, 1.1)
    rings = [p for p in np.unique(grid.orientations.pitch) if pitch[0] <= p <= pitch[1]]
    layers = [z for z in (grid.layer_height(k) for k in range(grid.layers)) if height[0] <= z <= height[1]]
    how = {"yaw_range": yaw_range, "free_space": table_floor, **LONG}
    found = coarse_inverse.query(CUP, pitch=pitch, height=height, **how)
    single = [coarse_inverse.query((*CUP[:2], z), pitch=p, **how).manipulability for z in layers for p in rings]
    clipped = [coarse_inverse.query((*CUP[:2], z), pitch=p, **how).manipulability for z in height for p in rings]
    clipped += [coarse_inverse.query((*CUP[:2], z), pitch=pitch[0], **how).manipulability for z in (*layers, *height)]
    every = np.sort(np.concatenate(single))[::-1]
    assert len(found) == LONG["k"]
    assert np.all(np.diff(found.manipulability) <= 0)
    assert found.manipulability[0] >= every[0]
    assert found.manipulability[0] == max(every[0], np.concatenate(clipped).max())
    assert np.all((found.pitch >= pitch[0]) & (found.pitch <= pitch[1]))
    assert np.all((found.height >= height[0]) & (found.height <= height[1]))
    assert np.all(found.roll == 0.0)


def test_bases_of_a_set_reach_the_pose_that_is_given_with_them(coarse_inverse, table_floor):
    found = coarse_inverse.query(CUP, pitch=(0.1, 1.2), height=(0.7, 1.0), free_space=table_floor, k=20)
    assert found.status is Status.YES
    assert found.certain.sum() > 10
    for k in np.flatnonzero(found.certain):
        T = pose((*CUP[:2], found.height[k]), found.approach_yaw[k], found.pitch[k])
        assert SOLVER.solve(in_base(found.poses[k], T[None]))[0][0] == Status.YES.value
    apart = np.linalg.norm(found.poses[:, None, :2] - found.poses[None, :, :2], axis=2)
    assert apart[~np.eye(len(found), dtype=bool)].min() > 0.1


def test_a_range_of_one_value_is_that_value(coarse_inverse, table_floor):
    for pitch in (0.0, 0.37, np.pi / 2):
        how = {"yaw_range": (-0.5, 0.5), "free_space": table_floor, "k": 5}
        one = coarse_inverse.query(CUP, pitch=pitch, **how)
        same = coarse_inverse.query(CUP, pitch=(pitch, pitch), height=(CUP[2], CUP[2]), **how)
        np.testing.assert_allclose(one.poses, same.poses, atol=1e-12)
        np.testing.assert_array_equal(one.manipulability, same.manipulability)
        assert one.status is same.status


def test_a_set_is_no_only_if_all_of_it_is(coarse_inverse):
    far = FreeSpace.from_boxes([(0.0, 0.0, 3.6, 3.6)], 0.3, (-4, -4, 4, 4))
    assert coarse_inverse.query((0, 0, 0.9), pitch=(-1.5, 1.5), height=(0.2, 1.4), free_space=far).status is Status.NO
    assert coarse_inverse.query((0, 0, 0.9), height=(2.9, 3.5)).status is Status.NO
    assert coarse_inverse.query((0, 0, 0.9), height=(0.9, 3.5)).status is Status.YES


@pytest.fixture(scope="module")
def rolling():
    """An arm whose wrist does not roll freely, with four rolls, without shapes."""
    chain = ArmChain.from_joints(TABLE, (0.1, 0.0, 0.0))
    return InverseReachabilityMap(ReachabilityMap.build(chain, voxel=0.15, orientations=26, rolls=4, samples=50_000))


def test_ranges_of_roll_have_the_best_of_their_rolls(rolling):
    how = {"yaw_range": (-0.6, 0.9), **LONG}
    for low, high in ((-np.pi, np.pi), (-0.2, np.pi / 2 + 0.1), (3.0, 4.0)):
        for pitch in (0.0, np.pi / 4, np.pi / 2):
            found = rolling.query((0.0, 0.0, 0.6), pitch=pitch, roll=(low, high), **how)
            rolls = [roll for roll in np.arange(-8, 9) * np.pi / 2 if low <= roll <= high]
            single = [rolling.query((0.0, 0.0, 0.6), pitch=pitch, roll=roll, **how) for roll in rolls]
            best = max((one.manipulability[0] for one in single if len(one)), default=0.0)
            assert (found.manipulability[0] if len(found) else 0.0) >= best
            assert len(found) == 0 or np.all((found.roll >= low - 1e-9) & (found.roll <= high + 1e-9))


def test_an_arm_without_shapes_says_that_its_answers_are_about_joints_alone(rolling, coarse_inverse):
    for one, expected in ((rolling, True), (coarse_inverse, False)):
        assert one.query((0.0, 0.0, 0.6)).joints_alone is expected
        assert ("joints alone" in str(one.query((0.0, 0.0, 0.6)))) is expected
        assert one.query_batch([(0.0, 0.0, 0.6)]).joints_alone is expected
        assert one.query_multi([(0.0, 0.0, 0.6), (0.1, 0.0, 0.6)]).joints_alone is expected
        assert one.query_path([(0.0, 0.0, 0.6)]).joints_alone is expected


def test_a_batch_of_poses_gives_what_single_queries_give(rolling, coarse_inverse, table_floor):
    rng = np.random.default_rng(3)
    for inverse, floor, z in ((coarse_inverse, table_floor, 0.9), (rolling, None, 0.5)):
        T = np.array([pose((*rng.uniform(-0.3, 0.3, 2), z), *rng.uniform(-1.5, 1.5, 3)) for _ in range(20)])
        T[::5] = [pose(one[:3, 3], rng.uniform(-3, 3), np.pi / 2, rng.uniform(-3, 3)) for one in T[::5]]
        for exact in (False, True):
            batch = inverse.query_batch(T, free_space=floor, k=3, exact=exact)
            for k, one in enumerate(T):
                single = inverse.query(one, free_space=floor, k=3, exact=False)
                if not exact:
                    assert batch.count[k] == len(single)
                    np.testing.assert_allclose(batch.poses[k, : len(single)], single.poses, atol=1e-9)
                    np.testing.assert_allclose(
                        wrap_to_pi(batch.approach_yaw[k, : len(single)] - single.approach_yaw), 0.0, atol=1e-9
                    )
                    np.testing.assert_array_equal(batch.certain[k, : len(single)], single.certain)
                assert batch.count[k] <= 3


def test_every_target_may_have_its_own_pitch(coarse_inverse, table_floor):
    targets, pitches = [(-0.25, -0.1, 0.82), (-0.2, 0.25, 0.9)], np.array([0.0, np.pi / 3])
    how = {"free_space": table_floor, "k": 3}
    found = coarse_inverse.query_multi(targets, pitches=pitches, exact=True, **how)
    assert found.status is Status.YES
    for base, yaws in zip(found.poses, found.approach_yaw, strict=True):
        T = np.array([tcp_poses(p, yaw, b)[0] for p, yaw, b in zip(targets, yaws, pitches, strict=True)])
        assert np.all(SOLVER.solve(in_base(base, T))[0] == Status.YES.value)
    same = coarse_inverse.query_multi(targets, pitches=[0.3, 0.3], **how)
    np.testing.assert_array_equal(same.poses, coarse_inverse.query_multi(targets, pitch=0.3, **how).poses)
    poses = [pose(p, yaw, b) for p, yaw, b in zip(targets, found.approach_yaw[0], pitches, strict=True)]
    again = coarse_inverse.query_multi(poses, exact=True, **how)
    assert again.status is Status.YES
    np.testing.assert_allclose(wrap_to_pi(again.approach_yaw - found.approach_yaw[0]), 0.0, atol=1e-4)


@pytest.mark.parametrize("yaw_range", [(-np.pi, np.pi), (-1.0, 1.2)])
def test_the_yaw_of_the_base_can_be_limited(coarse_map, coarse_inverse, table_floor, cups, yaw_range):
    """All kinds of queries keep the limits; the best base within them is that of a list of all bases."""
    limits = (2.8, 3.9)  # across π
    how = {"yaw_range": yaw_range, "free_space": table_floor}
    classical, some = ClassicalInverseReachabilityMap(coarse_map), 0
    for cup in cups[:6]:
        every = coarse_inverse.query(cup, **how, **(LONG | {"k": 20_000}))
        within = np.mod(every.poses[:, 2] - limits[0], 2 * np.pi) <= limits[1] - limits[0]
        found = coarse_inverse.query(cup, base_yaw_range=limits, exact=False, **how)
        old = classical.query(cup, base_yaw_range=limits, exact=False, **how)
        assert len(found) == len(old) == min(1, within.sum())
        if len(found):
            some += 1
            assert found.manipulability[0] == old.manipulability[0] == every.manipulability[within][0]
        answers = [
            coarse_inverse.query(cup, base_yaw_range=limits, k=10, **how),
            coarse_inverse.query(cup, base_yaw_range=limits, pitch=(0.0, 0.8), k=10, **how),
            coarse_inverse.query_path([(0, 0, 0), (0, 0, 0.1)], target=cup, base_yaw_range=limits, k=5, **how),
            coarse_inverse.query_multi([cup, cup + 0.05], yaw_ranges=yaw_range, base_yaw_range=limits, k=5),
        ]
        batch = coarse_inverse.query_batch(
            [cup], yaw_ranges=yaw_range, free_space=table_floor, base_yaw_range=limits, k=10
        )
        yaws = np.concatenate([*(one.poses[:, 2] for one in answers), batch.poses[0, : batch.count[0], 2]])
        assert np.all(np.mod(yaws - limits[0] + 1e-4, 2 * np.pi) <= limits[1] - limits[0] + 2e-4)
    assert some > 0


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda m: m.query(CUP, pitch=(0.5, 0.1)), "is empty"),
        (lambda m: m.query(CUP, pitch=(0.5, np.nan)), "finite"),
        (lambda m: m.query(CUP, height=0.8), "a range"),
        (lambda m: m.query(CUP, roll=(-4.0, 4.0)), "full turn"),
        (lambda m: m.query(CUP, base_yaw_range=(1.0, 0.0)), "is empty"),
        (lambda m: m.query_batch([CUP], pitch=(0.0, 0.5)), "for `query` alone"),
        (lambda m: m.query_path([CUP], height=(0.0, 0.5)), "for `query` alone"),
        (lambda m: m.query_multi([CUP, CUP], pitches=[0.0, 0.1, 0.2]), "one for each of 2 targets"),
        (lambda m: m.query_multi(np.eye(4)[None], pitches=[0.0]), "have their own angles"),
        (lambda m: m.query_batch(np.eye(4)[None], pitch=0.1), "have their own angles"),
        (lambda m: m.query_batch(np.zeros((1, 4, 4))), "not a rotation"),
    ],
)
def test_sets_without_meaning_are_refused(coarse_inverse, ask, message):
    with pytest.raises(QueryError, match=message):
        ask(coarse_inverse)
