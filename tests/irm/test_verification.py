"""Exact verification of proposed bases."""

from __future__ import annotations

import numpy as np
import pytest

from irm.errors import QueryError
from irm.kinematics import forward
from irm.verification import LARGEST_STEP, NotVerified, SelfCollision, Verified, tcp_poses, verify
from tests.irm.arms import CHAIN, PATH, arm_chain, in_base, in_world


def path_of(placement, cup):
    return lambda rank: tcp_poses(in_world(cup, placement.approach_yaw[rank]), placement.approach_yaw[rank])


def test_verified_configurations_reach_the_tcp_poses_in_small_steps(level_inverse, table_floor, cups):
    for cup in cups[:6]:
        placement = level_inverse.query_path(PATH, target=cup, free_space=table_floor, k=5)
        poses_of = path_of(placement, cup)
        result = verify(CHAIN, placement, poses_of)
        assert isinstance(result, Verified)
        T_base_tcp = in_base(result.base, poses_of(result.rank))
        np.testing.assert_allclose([forward(CHAIN, q) for q in result.configurations], T_base_tcp, atol=1e-6)
        steps = np.abs(np.diff(result.configurations, axis=0))
        steps[:, [3, 5, 7]] = np.minimum(steps[:, [3, 5, 7]], 2 * np.pi - steps[:, [3, 5, 7]])
        assert steps.max() <= LARGEST_STEP


def test_the_callers_check_decides(level_inverse, table_floor, cups):
    placement = level_inverse.query(cups[0], free_space=table_floor, k=4)
    poses_of = lambda rank: tcp_poses(cups[0], placement.approach_yaw[rank])  # noqa: E731
    assert verify(CHAIN, placement, poses_of, lambda *_: False) == NotVerified((0, 0, 0, 0))
    refused = placement.poses[0]
    result = verify(CHAIN, placement, poses_of, lambda base, _: not np.array_equal(base, refused))
    assert isinstance(result, Verified)
    assert result.rank == 1


def test_poses_of_a_wrong_shape_are_refused(level_inverse, cups):
    placement = level_inverse.query(cups[0])
    with pytest.raises(QueryError, match=r"\(m, 4, 4\)"):
        verify(CHAIN, placement, lambda _: np.eye(4))


def test_a_folded_arm_touches_itself_and_a_stretched_one_does_not():
    is_free = SelfCollision(arm_chain("pr2_arm"))
    stretched = np.array([0.2, -0.5, 0.0, 0.0, -0.3, 0.0, -0.1, 0.0])
    folded = np.array([0.2, 0.7, 0.9, 0.0, -2.3, 0.0, -2.0, 0.0])
    assert is_free(np.zeros(3), stretched)
    assert not is_free(np.zeros(3), folded)
    assert is_free(np.array([5.0, 1.0, 2.0]), stretched)
