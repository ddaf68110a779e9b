"""Answers of the map and of the exact solver, against oracles that share no code with the map."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from assets.robots import FETCH
from irm.answers import Status
from irm.chain import ArmChain, chain_arrays
from irm.classification import classify, decide
from irm.errors import QueryError
from irm.ik.closed_form import ik_pan
from irm.ik.numerical import random_seeds, solve
from irm.ik.solvers import ExactSolver
from irm.reachability_map import ReachabilityMap
from irm.rotations import rotation

CHAIN = ArmChain.from_robot(FETCH)
ARM = chain_arrays(CHAIN)
SHOULDER = np.array([CHAIN.links[0], 0.0, CHAIN.links[1] + CHAIN.links[3] + 0.21])
NO, UNKNOWN, YES = (Status.NO.value, Status.UNKNOWN.value, Status.YES.value)


def poses_in_ball(count, rng, radius=1.25):
    """TCP poses (n, 4, 4), uniform in a ball around the shoulder, with uniform approach directions."""
    direction, approach = rng.normal(size=(2, count, 3))
    place = (
        direction / np.linalg.norm(direction, axis=1, keepdims=True) * radius * rng.uniform(size=(count, 1)) ** (1 / 3)
    )
    approach /= np.linalg.norm(approach, axis=1, keepdims=True)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, 3] = SHOULDER + place
    for k, a in enumerate(approach):
        T[k, :3, :3] = rotation(np.arctan2(a[1], a[0]), -np.arcsin(a[2]), rng.uniform(-np.pi, np.pi))
    return T


def scan(T, pans=361, torsos=36):
    """Brute force: whether any pan angle and torso height of a fine grid solves the pose."""
    rows, approach = np.empty((2, 5)), np.ascontiguousarray(T[:3, 0])
    for torso in np.linspace(CHAIN.lower[0], CHAIN.upper[0], torsos):
        wrist = T[:3, 3] - CHAIN.links[6] * approach - [CHAIN.links[0], 0.0, CHAIN.links[1] + torso]
        if np.linalg.norm(wrist) > CHAIN.links[2:6].sum():
            continue
        for pan in np.linspace(CHAIN.lower[1], CHAIN.upper[1], pans):
            if ik_pan(ARM, approach, wrist, np.cos(pan), np.sin(pan), rows):
                return True
    return False


@pytest.fixture(scope="module")
def tcp_of():
    """T_base_tcp (4, 4) of a configuration, by MuJoCo, the base at the origin."""
    model = mujoco.MjModel.from_xml_path(str(FETCH.mjcf_path))
    data = mujoco.MjData(model)
    address = [model.joint(link.joint).qposadr[0] for link in FETCH.chain]
    base, site = model.body(FETCH.base_body).id, model.site(FETCH.tcp_site).id

    def pose(q):
        data.qpos[address] = q
        mujoco.mj_kinematics(model, data)
        world = [np.eye(4), np.eye(4)]
        for T, R, p in zip(
            world, (data.xmat[base], data.site_xmat[site]), (data.xpos[base], data.site_xpos[site]), strict=True
        ):
            T[:3, :3], T[:3, 3] = R.reshape(3, 3), p
        return np.linalg.inv(world[0]) @ world[1]

    return pose


def test_yes_comes_with_a_configuration_that_reaches_in_mujoco(tcp_of):
    T = poses_in_ball(4000, np.random.default_rng(0))
    answers, configurations = ExactSolver(CHAIN).solve(T)
    reached = np.flatnonzero(answers == YES)
    assert len(reached) > 600
    assert np.isnan(configurations[answers != YES]).all()
    assert np.all(configurations[reached] >= CHAIN.lower - 1e-9)
    assert np.all(configurations[reached] <= CHAIN.upper + 1e-9)
    for k in reached:
        np.testing.assert_allclose(tcp_of(configurations[k]), T[k], atol=1e-8)


@pytest.mark.slow
def test_no_is_said_where_neither_a_scan_nor_numerical_ik_finds_a_configuration():
    rng = np.random.default_rng(1)
    T = poses_in_ball(1500, rng)
    answers, _ = ExactSolver(CHAIN).solve(T)
    refused = np.flatnonzero(answers == NO)
    assert not any(scan(T[k]) for k in refused)
    seeds = np.concatenate([random_seeds(CHAIN, 3, torso, rng) for torso in (0.05, 0.2, 0.38)])
    assert not any(len(solve(CHAIN, T[k], seeds)) for k in refused[:400])


@pytest.mark.slow
def test_reachable_configurations_are_never_refused(tcp_of):
    """Also with joints at their limits and at singular configurations."""
    rng = np.random.default_rng(2)
    low, high = np.maximum(CHAIN.lower, -np.pi), np.minimum(CHAIN.upper, np.pi)
    q = rng.uniform(low, high, size=(3000, 8))
    edge = rng.uniform(size=q.shape) < 0.25
    q = np.where(edge, np.where(rng.uniform(size=q.shape) < 0.5, low, high), q)
    q[:500, 4], q[250:750, 6] = 0.0, 0.0
    answers, _ = ExactSolver(CHAIN).solve(np.array([tcp_of(one) for one in q]))
    assert not np.any(answers == NO)
    assert np.mean(answers == YES) > 0.8
    inside = np.logical_not(edge.any(axis=1))
    inside[:750] = False
    assert np.all(answers[inside] == YES)


def test_decide_agrees_with_the_map_where_it_is_certain_and_leaves_nothing_open(coarse_map):
    T = poses_in_ball(5000, np.random.default_rng(3))
    from_map, decided = classify(coarse_map, T), decide(coarse_map, T)
    certain = from_map != UNKNOWN
    np.testing.assert_array_equal(decided[certain], from_map[certain])
    np.testing.assert_array_equal(decided, ExactSolver(CHAIN).solve(T)[0])
    assert np.mean(from_map == UNKNOWN) > 0.2
    assert np.mean(decided == UNKNOWN) <= 0.001


def test_poses_that_a_map_does_not_cover_are_decided(level_map, coarse_map):
    T = poses_in_ball(500, np.random.default_rng(4))
    np.testing.assert_array_equal(decide(level_map, T), decide(coarse_map, T))
    below = poses_in_ball(4000, np.random.default_rng(5))
    below = below[below[:, 2, 3] < 0]
    assert np.any(decide(coarse_map, below) == YES)
    assert not np.any(classify(coarse_map, below) == NO)


def test_matrices_that_are_no_poses_are_refused(coarse_map):
    scaled, mirrored = 2 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0])
    for answer in (decide, classify):
        for bad in (np.zeros((4, 4)), scaled, mirrored):
            with pytest.raises(QueryError, match="pose 1 is not a rotation"):
                answer(coarse_map, [np.eye(4), bad])
        with pytest.raises(QueryError, match="array"):
            answer(coarse_map, "poses")


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
            if ik_pan(ARM, approach, wrist, np.cos(pan), np.sin(pan), rows):
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


def test_centres_of_reachable_cells_are_never_called_out_of_reach(coarse_map):
    some = np.random.default_rng(2).choice(len(coarse_map), 300, replace=False)
    T = np.tile(np.eye(4), (300, 1, 1))
    T[:, :3, 3] = coarse_map.positions[some]
    T[:, :3, :3] = [rotation(*angles) for angles in coarse_map.yaw_pitch_roll[some]]
    assert np.all(classify(coarse_map, T) != Status.NO.value)


def test_misuse_is_refused(coarse_map, level_map):
    with pytest.raises(QueryError, match=r"\(n, 4, 4\)"):
        classify(coarse_map, np.eye(4))
    with pytest.raises(QueryError, match="finite"):
        classify(coarse_map, np.full((1, 4, 4), np.nan))
    with pytest.raises(QueryError, match="all pitches and heights"):
        classify(level_map, np.eye(4)[None])
