"""Answers of the map and of the exact solver, against oracles that share no code with the map."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from assets.robots import FETCH
from irm.answers import Status
from irm.errors import QueryError
from irm.ik.numerical import random_seeds
from irm.ik.solvers import ExactSolver
from irm.inverse_map import InverseReachabilityMap
from irm.kinematics import forward
from irm.packed_cells import pack_cells
from irm.reachability_map import ReachabilityMap
from irm.rotations import rotations
from irm.verification import classify, decide, tcp_poses
from tests.irm.arms import CHAIN, is_reached, random_configurations, random_poses, solve

NO, UNKNOWN, YES = (Status.NO.value, Status.UNKNOWN.value, Status.YES.value)


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
        T = np.tile(np.eye(4), (2, 1, 1))
        T[:, :3, :3] = data.xmat[base].reshape(3, 3), data.site_xmat[site].reshape(3, 3)
        T[:, :3, 3] = data.xpos[base], data.site_xpos[site]
        return np.linalg.inv(T[0]) @ T[1]

    return pose


def test_yes_comes_with_a_configuration_that_reaches_in_mujoco(tcp_of):
    T = random_poses(CHAIN, 4000, np.random.default_rng(0))
    answers, configurations = ExactSolver(CHAIN).solve(T)
    reached = np.flatnonzero(answers == YES)
    assert len(reached) > 500
    assert np.isnan(configurations[answers != YES]).all()
    assert np.all(configurations[reached] >= CHAIN.lower - 1e-9)
    assert np.all(configurations[reached] <= CHAIN.upper + 1e-9)
    for k in reached:
        np.testing.assert_allclose(tcp_of(configurations[k]), T[k], atol=1e-8)


@pytest.mark.slow
def test_no_is_said_where_neither_a_scan_nor_numerical_ik_finds_a_configuration():
    rng = np.random.default_rng(1)
    T = random_poses(CHAIN, 1500, rng)
    answers, _ = ExactSolver(CHAIN).reach(T)
    refused = np.flatnonzero(answers == NO)
    assert not any(is_reached(T[k]) for k in refused)
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
    answers, _ = ExactSolver(CHAIN).reach(np.array([tcp_of(one) for one in q]))
    assert not np.any(answers == NO)
    assert np.mean(answers == YES) > 0.8
    inside = np.logical_not(edge.any(axis=1))
    inside[:750] = False
    assert np.all(answers[inside] == YES)


def test_decide_agrees_with_the_map_where_it_is_certain_and_leaves_little_open(coarse_map):
    T = random_poses(CHAIN, 5000, np.random.default_rng(3))
    from_map, decided = classify(coarse_map, T), decide(coarse_map, T)
    certain = from_map != UNKNOWN
    np.testing.assert_array_equal(decided[certain], from_map[certain])
    np.testing.assert_array_equal(decided, ExactSolver(CHAIN).solve(T)[0])
    assert np.mean(from_map == UNKNOWN) > 0.2
    # Open is only what the joints reach, and no configuration that was tried is free.
    open_ = T[decided == UNKNOWN]
    assert len(open_) < 0.15 * np.count_nonzero(decided == YES)
    assert np.all(ExactSolver(CHAIN).reach(open_)[0] == YES)


def test_poses_that_a_map_does_not_cover_are_decided(level_map, coarse_map):
    T = random_poses(CHAIN, 150, np.random.default_rng(4))
    np.testing.assert_array_equal(decide(level_map, T), decide(coarse_map, T))


def test_poses_below_the_base_are_never_called_out_of_reach_wrongly(coarse_map):
    """NO was said of all that lies below the origin of the base frame: 4 of these 15 are in reach."""
    in_front = tcp_poses([(x, 0.0, -0.02) for x in np.linspace(0.45, 0.95, 15)], 0.0, np.pi / 2)
    assert np.count_nonzero(decide(coarse_map, in_front) == YES) == 4
    below = random_poses(CHAIN, 20_000, np.random.default_rng(5))
    below = np.concatenate([in_front, below[below[:, 2, 3] < 0]])
    truth = ExactSolver(CHAIN).solve(below)[0]
    np.testing.assert_array_equal(decide(coarse_map, below), truth)
    assert not np.any((classify(coarse_map, below) == NO) & (truth != NO))
    query = InverseReachabilityMap(coarse_map).query((0.0, 0.0, -0.02), pitch=np.pi / 2, exact=True)
    assert query.status is Status.YES


def test_a_map_whose_rolls_are_far_apart_says_no_yes_between_them(lift_arm_map, coarse_map):
    """Of Panda's map, two of 10,000 poses between rolls that are 90 degrees apart were YES, and are out of reach."""
    for rm, best in ((lift_arm_map, UNKNOWN), (coarse_map, YES)):
        n = rm.grid.size
        every = np.ones(n, np.bool_)
        packed = pack_cells(rm.grid, every, every, np.ones(n, np.float32), np.zeros(n, np.uint8))
        full = dataclasses.replace(rm, packed=packed)
        answers = classify(full, random_poses(rm.chain, 200, np.random.default_rng(0), radius=0.5))
        assert np.all(answers == best)


def test_what_has_no_answer_is_refused(coarse_map, level_map):
    scaled, mirrored = 2 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0])
    for answer in (decide, classify):
        for bad in (np.zeros((4, 4)), scaled, mirrored):
            with pytest.raises(QueryError, match="pose 1 is not a rotation"):
                answer(coarse_map, [np.eye(4), bad])
        for bad in ("poses", np.eye(4), np.full((1, 4, 4), np.nan)):
            with pytest.raises(QueryError, match=r"array \(n, 4, 4\) of finite"):
                answer(coarse_map, bad)
    with pytest.raises(QueryError, match="all pitches and heights"):
        classify(level_map, np.eye(4)[None])


def test_no_of_a_map_that_was_filled_by_samples_is_proved(lift_arm_map):
    """Also where samples have found nothing; it said NO to 24 of TIAGo's free poses."""
    chain, rng = lift_arm_map.chain, np.random.default_rng(6)
    T = np.array([forward(chain, q) for q in random_configurations(chain, 200, rng)])
    empty = lift_arm_map.subset(np.zeros(len(lift_arm_map), dtype=bool))
    assert np.all(classify(empty, T) == UNKNOWN)
    others = random_poses(chain, 500, rng)
    refused = others[classify(lift_arm_map, others) == NO]
    assert len(refused) > 50
    assert np.all(ExactSolver(chain).reach(refused)[0] == NO)


@pytest.mark.slow
def test_answers_against_exact_inverse_kinematics():
    rm = ReachabilityMap.build(FETCH)
    T = random_poses(CHAIN, 4000, np.random.default_rng(0), radius=1.25)
    truth = ExactSolver(CHAIN).solve(T)[0]
    answer = classify(rm, T)
    assert not np.any((answer == YES) & (truth == NO))
    assert not np.any((answer == NO) & (truth == YES))
    assert np.mean(answer == UNKNOWN) < 0.4


def test_centres_of_reachable_cells_are_never_called_out_of_reach(coarse_map):
    some = np.random.default_rng(2).choice(len(coarse_map), 300, replace=False)
    T = np.tile(np.eye(4), (300, 1, 1))
    T[:, :3, 3] = coarse_map.positions[some]
    T[:, :3, :3] = rotations(*coarse_map.yaw_pitch_roll[some].T)
    assert np.all(classify(coarse_map, T) != Status.NO.value)
