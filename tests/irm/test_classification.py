"""YES and NO are never wrong; the plain map is right nearly always."""

import numpy as np
import pytest

from assets.robots import FETCH
from irm.answers import Status
from irm.chain import ArmChain
from irm.classification import classify, predict
from irm.errors import QueryError
from irm.ik.closed_form import ik_pan
from irm.reachability_map import ReachabilityMap
from irm.rotations import rotation

CHAIN = ArmChain.from_robot(FETCH)


def random_poses(rm, count, rng):
    """TCP poses with random positions in the map's box and random orientations."""
    grid = rm.grid
    edge = grid.half * grid.voxel
    low, high = [grid.centre[0] - edge, grid.centre[1] - edge, grid.bottom], [grid.centre[0] + edge, edge, grid.top]
    approach = rng.normal(size=(count, 3))
    approach /= np.linalg.norm(approach, axis=1, keepdims=True)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, 3] = rng.uniform(low, high, size=(count, 3))
    for k, a in enumerate(approach):
        T[k, :3, :3] = rotation(np.arctan2(a[1], a[0]), -np.arcsin(a[2]), rng.uniform(-np.pi, np.pi))
    return T


def is_reachable(T):
    rows = np.empty((2, 5))
    approach = T[:3, 0].copy()
    for torso in np.linspace(CHAIN.lower[0], CHAIN.upper[0], 12):
        wrist = T[:3, 3] - CHAIN.links[6] * approach - [CHAIN.links[0], 0.0, CHAIN.links[1] + torso]
        if np.linalg.norm(wrist - [0, 0, CHAIN.links[3]]) > CHAIN.links[2:6].sum():
            continue
        for pan in np.linspace(CHAIN.lower[1], CHAIN.upper[1], 181):
            if ik_pan(CHAIN.links, approach, wrist, np.cos(pan), np.sin(pan), CHAIN.lower, CHAIN.upper, rows):
                return True
    return False


@pytest.mark.slow
def test_answers_against_exact_inverse_kinematics():
    rm = ReachabilityMap.build(FETCH)
    T = random_poses(rm, 800, np.random.default_rng(0))
    truth = np.array([is_reachable(pose) for pose in T])
    answer = classify(rm, T)
    assert not np.any((answer == Status.YES.value) & ~truth)
    assert not np.any((answer == Status.NO.value) & truth)
    assert np.mean(answer == Status.UNKNOWN.value) < 0.3
    assert np.mean(predict(rm, T) == truth) > 0.98


def test_centres_of_cells_are_predicted_as_they_are(coarse_map):
    some = np.random.default_rng(2).choice(len(coarse_map), 300, replace=False)
    T = np.tile(np.eye(4), (300, 1, 1))
    T[:, :3, 3] = coarse_map.positions[some]
    T[:, :3, :3] = [rotation(*angles) for angles in coarse_map.yaw_pitch_roll[some]]
    assert predict(coarse_map, T).all()
    assert np.all(classify(coarse_map, T) != Status.NO.value)


def test_misuse_is_refused(coarse_map, level_map):
    with pytest.raises(QueryError, match=r"\(n, 4, 4\)"):
        classify(coarse_map, np.eye(4))
    with pytest.raises(QueryError, match="finite"):
        predict(coarse_map, np.full((1, 4, 4), np.nan))
    with pytest.raises(QueryError, match="all pitches and heights"):
        classify(level_map, np.eye(4)[None])
