"""One base for two arms, and bases that tolerate error."""

from __future__ import annotations

import numpy as np
import pytest

import assets
from assets.robots import FETCH
from irm import (
    FreeSpace,
    InverseReachabilityMap,
    QueryError,
    ReachabilityMap,
    SelfCollision,
    Status,
    forward,
    query_tolerant,
    tcp_poses,
)
from irm.ik.solvers import ExactSolver
from tests.irm.arms import in_base

COARSE = {"voxel": 0.1, "rolls": 1, "pitches": (0.0,), "heights": (0.6, 1.1), "samples": 100_000}


@pytest.fixture(scope="module")
def two_arms():
    pr2 = assets.robot("pr2")
    return [InverseReachabilityMap(ReachabilityMap.build(pr2.using(arm), **COARSE)) for arm in ("left", "right")]


def test_both_hands_reach_from_one_base(two_arms):
    tray = np.array([(0.0, 0.15, 0.8), (0.0, -0.15, 0.8)])
    floor = FreeSpace.from_boxes([(0.3, 0.0, 0.7, 1.2)], radius=0.34)
    found = two_arms[0].query_multi(tray, arms=two_arms, yaw_ranges=(-0.4, 0.4), free_space=floor, k=3)
    assert found.status is Status.YES
    assert found.configurations.shape[:2] == (len(found), 2)
    for base, yaws, q in zip(found.poses, found.approach_yaw, found.configurations, strict=True):
        assert floor.is_free(*base[:2])
        for arm, target, yaw, one in zip(two_arms, tray, yaws, q, strict=True):
            chain, T = arm.reachability_map.chain, tcp_poses(target, yaw)
            np.testing.assert_allclose(forward(chain, one), in_base(base, T)[0], atol=1e-4)
            assert SelfCollision(chain)(base, one)
            assert -0.4 - 1e-6 <= yaw <= 0.4 + 1e-6
        assert q[0, 0] == q[1, 0]  # they stand on one lift


def test_hands_too_far_apart_have_no_common_base(two_arms):
    far = [(0.0, 2.0, 0.8), (0.0, -2.0, 0.8)]
    assert two_arms[0].query_multi(far, arms=two_arms).status is not Status.YES
    with pytest.raises(QueryError, match="2 arms"):
        two_arms[0].query_multi([(0.0, 0.0, 0.8)], arms=two_arms)


def test_tolerant_bases_reach_more_often(coarse_inverse, table_floor, cups):
    """Against exact inverse kinematics at random errors: the chosen order is better than that of μ."""
    deviation, solver, gained = np.array([0.05, 0.05, 0.08]), ExactSolver(coarse_inverse.reachability_map.chain), []
    for cup in cups[:6]:
        rng = np.random.default_rng(0)
        how = {"yaw_range": (-0.9, 0.9), "free_space": table_floor}
        placement, probability = query_tolerant(coarse_inverse, cup, np.diag(deviation**2), rng, k=3, **how)
        assert len(placement) == len(probability) == 3
        assert np.all(np.diff(probability) <= 0)
        shares = []
        for answer in (placement, coarse_inverse.query(cup, **how)):
            base, T = answer.poses[0], tcp_poses(cup, answer.approach_yaw[0])
            c, s = np.cos(base[2]), np.sin(base[2])
            errors = rng.normal(size=(60, 3)) * deviation
            turned = errors[:, :2] @ np.array([[c, s], [-s, c]])
            moved = base + np.column_stack([turned, errors[:, 2]])
            poses = np.concatenate([in_base(one, T) for one in moved])
            shares.append(np.mean(solver.solve(poses)[0] == Status.YES.value))
        assert abs(shares[0] - probability[0]) < 0.2
        gained.append(shares[0] - shares[1])
    assert np.mean(gained) >= 0.0
    with pytest.raises(QueryError, match="covariance"):
        query_tolerant(coarse_inverse, cups[0], np.diag([1.0, 1.0]), rng)


def test_without_self_collision_a_map_is_that_of_the_joints():
    small = {"voxel": 0.2, "orientations": 26}
    joints, free = ReachabilityMap.build(FETCH, self_collision=False, **small), ReachabilityMap.build(FETCH, **small)
    np.testing.assert_array_equal(joints.cells, free.cells)
    assert joints.manipulability.min() > 0.0
    assert np.all(joints.manipulability >= free.manipulability)
    assert 0 < np.count_nonzero(free.manipulability == 0) < 0.5 * len(free)
