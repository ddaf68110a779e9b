"""From an MJCF file to the first answers, for an arm that this project has no description of."""

import numpy as np
import pytest

from irm import ArmChain, InverseReachabilityMap, ReachabilityMap, Status, decide
from irm.classification import classify
from irm.kinematics import forward
from tests.irm.arms import FOLDER


@pytest.fixture(scope="module")
def ur5e():
    return ArmChain.from_mjcf(FOLDER / "ur5e.xml", base="base", tip="tcp", approach="z")


@pytest.fixture(scope="module")
def ur5e_map(ur5e):
    return ReachabilityMap.build(ur5e, voxel=0.1, orientations=26, samples=50_000)


@pytest.mark.slow
def test_from_the_file_to_a_query(ur5e_map):
    placement = InverseReachabilityMap(ur5e_map).query((0.5, 0.0, 0.4), pitch=np.pi / 2, k=3)
    assert placement.status is not Status.NO
    assert len(placement) == 3
    assert np.hypot(*(placement.poses[:, :2] - (0.5, 0.0)).T).max() < 1.2


@pytest.mark.slow
def test_poses_of_the_arm_are_decided_and_right(ur5e, ur5e_map):
    rng = np.random.default_rng(0)
    T = np.array([forward(ur5e, q) for q in rng.uniform(ur5e.lower, ur5e.upper, (300, ur5e.size))])
    assert np.all(decide(ur5e_map, T) == Status.YES.value)
    far = np.tile(np.eye(4), (1, 1, 1))
    far[0, :3, 3] = 2.0, 0.0, 0.5
    assert decide(ur5e_map, far)[0] == Status.NO.value


@pytest.mark.slow
def test_what_a_sampled_map_says_no_to_is_asked_again(ur5e, ur5e_map):
    rng = np.random.default_rng(1)
    T = np.array([forward(ur5e, q) for q in rng.uniform(ur5e.lower, ur5e.upper, (200, ur5e.size))])
    empty = ur5e_map.subset(np.zeros(len(ur5e_map), dtype=bool))
    above = T[T[:, 2, 3] > 0]
    assert np.all(classify(empty, above) == Status.NO.value)
    assert np.all(decide(empty, above) == Status.YES.value)
