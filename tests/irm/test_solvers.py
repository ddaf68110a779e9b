"""Solvers of any arm: no wrong YES, no wrong NO, little that stays open, and all solutions of a pose."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from assets.robots import FETCH
from irm.chain import ArmChain
from irm.ik.closed_form import MIRRORED, NOT_MIRRORED
from irm.ik.numerical import random_seeds
from irm.ik.solvers import ExactSolver, arm_solutions, free_angles, solver_arrays
from irm.ik.structure import ParallelArm, SphericalArm, find_structure
from irm.kinematics import forward, link_origins
from tests.irm.arms import APPROACH, arm_chain, random_configurations, random_poses, solve

NO, OPEN, YES = 0, 1, 2


@pytest.mark.parametrize("name", APPROACH)
@pytest.mark.parametrize("near_limits", [False, True])
def test_a_pose_of_the_arm_is_never_called_out_of_reach(name, near_limits):
    chain = arm_chain(name)
    T = np.array([forward(chain, q) for q in random_configurations(chain, 400, np.random.default_rng(0), near_limits)])
    status, _ = ExactSolver(chain).reach(T)
    assert np.mean(status == YES) > 0.99
    assert not np.any(status == NO)


@pytest.mark.parametrize("name", APPROACH)
def test_a_singular_pose_is_never_called_out_of_reach(name):
    chain, rng = arm_chain(name), np.random.default_rng(0)
    Q = random_configurations(chain, 200, rng)
    Q = np.where(rng.random(Q.shape) < 0.3, np.clip(0.0, chain.lower, chain.upper), Q)
    status, _ = ExactSolver(chain).reach(np.array([forward(chain, q) for q in Q]))
    assert not np.any(status == NO)
    assert np.mean(status == YES) > 0.99


@pytest.mark.parametrize("name", APPROACH)
def test_every_yes_comes_with_a_configuration_within_the_limits_that_reaches(name):
    chain = arm_chain(name)
    T = random_poses(chain, 300, np.random.default_rng(1))
    status, q = ExactSolver(chain).solve(T)
    assert np.isnan(q[status != YES]).all()
    assert np.any(status == YES)
    for pose, configuration in zip(T[status == YES], q[status == YES], strict=True):
        np.testing.assert_allclose(forward(chain, configuration), pose, atol=3e-5)
        assert np.all((configuration >= chain.lower) & (configuration <= chain.upper))


@pytest.mark.slow
@pytest.mark.parametrize("name", APPROACH)
def test_no_is_confirmed_by_numerical_inverse_kinematics_and_little_is_open(name):
    chain, rng = arm_chain(name), np.random.default_rng(2)
    T = random_poses(chain, 200, rng)
    status, _ = ExactSolver(chain).reach(T)
    assert np.mean(status == OPEN) <= 0.05
    assert np.any(status == NO)
    for pose in T[status == NO]:
        heights = rng.uniform(chain.lower[0], chain.upper[0], 4)
        seeds = np.concatenate([random_seeds(chain, 25, height, rng) for height in heights])
        assert len(solve(chain, pose, seeds)) == 0


def test_structures():
    kinds = {name: find_structure(arm_chain(name)) for name in APPROACH}
    assert isinstance(kinds["ur5e"], ParallelArm)
    assert {name for name, kind in kinds.items() if isinstance(kind, SphericalArm)} == {"panda", "gen3", "pr2_arm"}
    assert kinds["panda"].reversed
    assert not kinds["pr2_arm"].reversed
    assert kinds["gen3"].slack > 1e-3  # its wrist axes pass each other at 0.2 mm


@pytest.mark.slow
def test_without_a_structure_no_is_by_length_alone(lift_arm):
    chain = ArmChain.from_robot(lift_arm)
    no_axes_meet = chain.offsets + [
        (0, 0, 0),
        (0, 0, 0),
        (0.04, 0, 0),
        (0, 0, 0.05),
        (0, 0, 0.05),
        (0, 0.05, 0),
        (0, 0.03, 0),
    ]
    bent = dataclasses.replace(chain, offsets=no_axes_meet, axes=np.array([5, 2, 1, 0, 1, 2, 0]))
    assert find_structure(bent) is None
    rng = np.random.default_rng(4)
    reached = np.array([forward(bent, q) for q in random_configurations(bent, 40, rng)])
    far = np.tile(np.eye(4), (3, 1, 1))
    far[:, 0, 3] = 3.0
    status, _ = ExactSolver(bent).reach(np.concatenate([reached, far]))
    assert not np.any(status[:40] == NO)
    assert np.mean(status[:40] == YES) > 0.9
    assert np.all(status[40:] == NO)


def test_without_a_structure_the_lengths_of_the_links_refuse_most_of_what_is_out_of_reach():
    chain = arm_chain("ur5e")
    bent = chain.offsets.copy()
    bent[3:, :3] += 0.02
    chain, rng = dataclasses.replace(chain, offsets=bent), np.random.default_rng(0)
    assert find_structure(chain) is None
    solver = ExactSolver(chain)
    reached = solver.reach(np.array([forward(chain, q) for q in random_configurations(chain, 300, rng, True)]))[0]
    assert not np.any(reached == NO)
    assert np.mean(reached == YES) > 0.97
    others = solver.reach(random_poses(chain, 200, rng))[0]
    assert np.mean(others[others != YES] == NO) > 0.6


def test_parallel_axes_on_a_lift(lift_arm):
    chain, rng = ArmChain.from_robot(lift_arm), np.random.default_rng(5)
    assert isinstance(find_structure(chain), ParallelArm)
    T = np.array([forward(chain, q) for q in random_configurations(chain, 200, rng, True)])
    status, q = ExactSolver(chain).reach(T)
    assert np.all(status == YES)
    for pose, configuration in zip(T, q, strict=True):
        np.testing.assert_allclose(forward(chain, configuration), pose, atol=3e-5)


CHAINS = {**{name: arm_chain(name) for name in APPROACH}, "fetch": ArmChain.from_robot(FETCH)}


@pytest.mark.parametrize("name", CHAINS)
def test_the_configuration_behind_a_pose_is_among_its_solutions(name: str) -> None:
    chain, rng = CHAINS[name], np.random.default_rng(0)
    solver, found = solver_arrays(chain), np.empty((8, chain.size))
    lower, upper = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
    away = list[float]()
    for q in rng.uniform(lower, upper, (300, chain.size)):
        T = forward(chain, q)
        R, p = np.ascontiguousarray(T[:3, :3]), T[:3, 3].copy()
        count = arm_solutions(solver, R, p, q[0], q[solver.free] if solver.free >= 0 else 0.0, found, MIRRORED)
        for solution in found[:count]:
            assert np.abs(forward(chain, solution) - T).max() < 2e-5
            assert np.all((solution >= chain.lower - 1e-6) & (solution <= chain.upper + 1e-6))
        differences = np.abs(np.mod(found[:count] - q + np.pi, 2 * np.pi) - np.pi).max(axis=1)
        away.append(differences.min(initial=np.inf))
    # the wrist of the Gen3 is 0.2 mm off: its solutions are refined, and near singular poses the joints drift
    share, tolerance = (0.9, 0.05) if name == "gen3" else (1.0, 1e-4)
    assert np.mean(np.array(away) < tolerance) >= share


def test_solutions_left_out_as_mirrored_have_the_links_of_others_at_the_same_places() -> None:
    chain, rng = ArmChain.from_robot(FETCH), np.random.default_rng(1)
    solver, every, some = solver_arrays(chain), np.empty((8, chain.size)), np.empty((8, chain.size))
    lower, upper = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
    left_out = 0
    for q in rng.uniform(lower, upper, (100, chain.size)):
        T = forward(chain, q)
        pose, roll = (solver, np.ascontiguousarray(T[:3, :3]), T[:3, 3].copy(), q[0]), q[solver.free]
        count, kept = arm_solutions(*pose, roll, every, MIRRORED), arm_solutions(*pose, roll, some, NOT_MIRRORED)
        np.testing.assert_array_equal(some[:kept], every[:count][every[:count, solver.elbow] >= 0.0])
        # The others bend the elbow the other way, with the upper arm half a turn on.
        kept = arm_solutions(*pose, roll + np.pi if roll < 0.0 else roll - np.pi, some, NOT_MIRRORED)
        places = [link_origins(chain, one) for one in some[:kept]]
        for one in every[:count][every[:count, solver.elbow] < 0.0]:
            assert min(np.abs(link_origins(chain, one) - other).max() for other in places) < 1e-6
            left_out += 1
    assert left_out > 100


@pytest.mark.slow
def test_an_arm_without_a_closed_form_is_solved_by_iteration() -> None:
    chain = arm_chain("ur5e")
    offsets = chain.offsets.copy()
    turn = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(0.3), -np.sin(0.3)], [0.0, np.sin(0.3), np.cos(0.3)]])
    for row in offsets[1:]:
        row[3:] = (row[3:].reshape(3, 3) @ turn).ravel()
    skewed = dataclasses.replace(chain, offsets=offsets)
    solver, found = solver_arrays(skewed), np.empty((8, chain.size))
    T = forward(skewed, np.array([0.0, 0.3, -1.0, 1.2, 0.4, -0.7, 0.2]))
    counts = [
        arm_solutions(solver, np.ascontiguousarray(T[:3, :3]), T[:3, 3].copy(), 0.0, free, found, MIRRORED)
        for free in free_angles(skewed, 40)
    ]
    assert len(counts) == 40
    assert sum(counts) > 5
