"""The route of arms without a closed form, on a second robot and on Fetch with its closed form taken away."""

import dataclasses

import mujoco
import numpy as np
import pytest

from assets.robots import FETCH
from irm.chain import ArmChain
from irm.errors import ChainError
from irm.free_space import FreeSpace
from irm.ik.closed_form import inverse
from irm.ik.numerical import random_seeds, solve
from irm.inverse_map import InverseReachabilityMap
from irm.kinematics import forward, jacobian, manipulability
from irm.reachability_map import ReachabilityMap
from irm.rotations import rotation


@pytest.fixture(scope="module")
def chain(lift_arm):
    return ArmChain.from_robot(lift_arm)


def test_the_chain_is_that_of_the_model(chain, lift_arm, lift_arm_mjcf):
    model = mujoco.MjModel.from_xml_string(lift_arm_mjcf)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for _ in range(30):
        q = rng.uniform(chain.lower, chain.upper)
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        T = forward(chain, q)
        np.testing.assert_allclose(T[:3, 3], data.site("tcp").xpos, atol=1e-9)
        np.testing.assert_allclose(T[:3, :3], data.site("tcp").xmat.reshape(3, 3), atol=1e-9)
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, linear, angular, model.site("tcp").id)
        np.testing.assert_allclose(jacobian(chain, q), np.vstack([linear, angular])[:, 1:], atol=1e-9)
    assert lift_arm.closed_form_ik == ""


def test_numerical_solutions_are_exact_within_the_limits_and_found_from_near(chain):
    rng = np.random.default_rng(1)
    solved = 0
    for _ in range(60):
        q = rng.uniform(0.9 * chain.lower, 0.9 * chain.upper)
        T = forward(chain, q)
        seed = np.clip(q + rng.normal(0, 0.15, q.size) * (np.arange(q.size) > 0), chain.lower, chain.upper)
        for row in solve(chain, T, seed):
            np.testing.assert_allclose(forward(chain, row), T, atol=5e-5)
            assert np.all(row >= chain.lower)
            assert np.all(row <= chain.upper)
            assert row[0] == q[0]
            solved += 1
    assert solved > 50


def test_every_cell_of_the_sampled_map_is_reached(chain, lift_arm_map):
    rng = np.random.default_rng(2)
    positions, angles, torso = lift_arm_map.positions, lift_arm_map.yaw_pitch_roll, lift_arm_map.torso
    unsolved = 0
    for k in rng.choice(len(lift_arm_map), 40, replace=False):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rotation(*angles[k]), positions[k]
        found = solve(chain, T, random_seeds(chain, 150, torso[k], rng))
        unsolved += len(found) == 0
        if len(found):
            best = max(manipulability(jacobian(chain, q)) for q in found)
            assert lift_arm_map.manipulability[k] <= best + 1e-3
    assert unsolved <= 1


@pytest.mark.slow
def test_bases_for_the_second_robot_reach(chain, lift_arm_map):
    inverse_map = InverseReachabilityMap(lift_arm_map)
    floor = FreeSpace.from_boxes([(0, 0, 0.6, 1.0)], 0.3)
    rng = np.random.default_rng(3)
    reached = 0
    layers = lift_arm_map.grid
    for k in range(12):
        tcp = np.array([*rng.uniform(-0.2, 0.2, 2), layers.layer_height(layers.layer(0.9))])
        roll = (0.0, np.pi / 2)[k % 2]
        placement = inverse_map.query(tcp, roll=roll, free_space=floor)
        assert len(placement) == 1
        base, yaw = placement.poses[0], placement.approach_yaw[0]
        T = np.eye(4)
        c, s = np.cos(-base[2]), np.sin(-base[2])
        T[:3, :3] = rotation(yaw - base[2], 0.0, roll)
        dx, dy = tcp[:2] - base[:2]
        T[:3, 3] = c * dx - s * dy, s * dx + c * dy, tcp[2]
        reached += len(solve(chain, T, random_seeds(chain, 200, placement.torso[0], rng))) > 0
    assert reached == 12


@pytest.mark.slow
def test_without_its_closed_form_fetch_gets_nearly_the_same_map():
    parameters = {"voxel": 0.15, "orientations": 26, "heights": (0.6, 1.2), "lift": False}
    exact = ReachabilityMap.build(FETCH, **parameters)
    sampled = ReachabilityMap.build(dataclasses.replace(FETCH, closed_form_ik=""), samples=100_000, **parameters)
    both = np.intersect1d(exact.cells, sampled.cells).size
    assert both > 0.93 * len(exact)
    assert both > 0.97 * len(sampled)
    mu_exact = exact.manipulability[np.isin(exact.cells, sampled.cells)]
    mu_sampled = sampled.manipulability[np.isin(sampled.cells, exact.cells)]
    assert np.mean(mu_sampled > 0.8 * mu_exact) > 0.9
    assert exact.key != sampled.key


def test_the_closed_form_is_refused_for_the_second_robot(chain):
    with pytest.raises(ChainError, match=r"irm\.ik\.numerical\.solve"):
        inverse(chain, np.eye(4), [0.1], [0.0])
    with pytest.raises(ChainError, match="seeds"):
        solve(chain, np.eye(4), np.zeros((2, 3)))
