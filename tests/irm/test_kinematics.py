"""Kinematics of every kind of chain against MuJoCo, and laws of the closed form and of numerical solutions."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from assets import robot
from assets.robots import FETCH
from irm.chain import ArmChain
from irm.errors import ChainError
from irm.ik.closed_form import ik_pan
from irm.kinematics import forward
from irm.rotations import arctan2, rotation_vectors, rotations_by
from tests.irm.arms import (
    APPROACH,
    ARM,
    CHAIN,
    FOLDER,
    arm_model,
    inverse,
    jacobian,
    manipulability,
    random_configurations,
    solve,
)

ROLLS = np.linspace(-np.pi, np.pi, 72, endpoint=False)
ROBOTS = ("fetch", "pr2", "panda_mobile")
ODD_ARMS = {"odd": "stand", "odd in the world": "world"}


def chain_and_model(name):
    """A chain, its model, and what its base and tip are called there."""
    if name in ODD_ARMS:
        model = mujoco.MjModel.from_xml_path(str(FOLDER / "odd.xml"))
        return ArmChain.from_mjcf(model, ODD_ARMS[name], "tool"), model, ODD_ARMS[name], "tool"
    if name in ROBOTS:
        spec = robot(name)
        model = mujoco.MjModel.from_xml_path(str(spec.mjcf_path))
        return ArmChain.from_robot(spec), model, spec.base_body, spec.tcp_site
    return ArmChain.from_mjcf(arm_model(name), "base", "tcp"), arm_model(name), "base", "tcp"


@pytest.mark.parametrize("name", [*ROBOTS, *APPROACH, *ODD_ARMS])
def test_poses_and_jacobians_are_those_of_the_model(name):
    """Any axes, signs, anchors and reference positions; the tip may be a site or a body."""
    chain, model, base, tip = chain_and_model(name)
    data = mujoco.MjData(model)
    is_site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, tip) >= 0
    columns = [model.joint(joint).dofadr[0] for joint in chain.joints[1:]]
    for q in random_configurations(chain, 30, np.random.default_rng(0)):
        for joint, value in zip(chain.joints, q, strict=True):
            if joint:
                data.joint(joint).qpos[0] = value
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        frame, J = data.site(tip) if is_site else data.body(tip), np.zeros((2, 3, model.nv))
        (mujoco.mj_jacSite if is_site else mujoco.mj_jacBody)(model, data, *J, frame.id)
        R, origin = data.body(base).xmat.reshape(3, 3), data.body(base).xpos
        T = forward(chain, q)
        np.testing.assert_allclose(T[:3, 3], R.T @ (frame.xpos - origin), atol=1e-9)
        np.testing.assert_allclose(T[:3, :3], R.T @ frame.xmat.reshape(3, 3), atol=1e-9)
        np.testing.assert_allclose(jacobian(chain, q), np.vstack(R.T @ J)[:, columns], atol=1e-9)


def test_every_inverse_solution_reaches_the_pose_within_the_limits():
    solved = 0
    for configuration in random_configurations(CHAIN, 30, np.random.default_rng(1)):
        T = forward(CHAIN, configuration)
        for q in inverse(CHAIN, T, [0.05, 0.2, 0.35], ROLLS):
            np.testing.assert_allclose(forward(CHAIN, q), T, atol=1e-6)
            assert np.all((q >= CHAIN.lower) & (q <= CHAIN.upper))
            assert np.all(np.abs(q[[3, 5, 7]]) <= np.pi + 1e-9)
            solved += 1
    assert solved > 500


def test_solving_for_the_pan_agrees_with_solving_for_the_roll():
    out = np.empty((2, 5))
    for q in random_configurations(CHAIN, 200, np.random.default_rng(3)):
        T = forward(CHAIN, q)
        approach = T[:3, 0]
        wrist = T[:3, 3] - CHAIN.links[6] * approach - [CHAIN.links[0], 0, CHAIN.links[1] + q[0]]
        count = ik_pan(ARM, approach, wrist, np.cos(q[1]), np.sin(q[1]), out)
        assert count >= 1
        for row in out[:count]:
            found = forward(CHAIN, [q[0], q[1], *row, 0.0])
            np.testing.assert_allclose(found[:3, [0, 3]], T[:3, [0, 3]], atol=1e-6)


def test_numerical_solutions_are_exact_within_the_limits_and_found_from_near(lift_arm):
    chain, rng, solved = ArmChain.from_robot(lift_arm), np.random.default_rng(1), 0
    for q in rng.uniform(0.9 * chain.lower, 0.9 * chain.upper, (60, chain.size)):
        T = forward(chain, q)
        seed = np.clip(q + rng.normal(0, 0.15, q.size) * (np.arange(q.size) > 0), chain.lower, chain.upper)
        for row in solve(chain, T, seed):
            np.testing.assert_allclose(forward(chain, row), T, atol=5e-5)
            assert np.all((row >= chain.lower) & (row <= chain.upper))
            assert row[0] == q[0]
            solved += 1
    assert solved > 50


def test_manipulability_is_the_ratio_of_singular_values():
    rng = np.random.default_rng(4)
    for _ in range(200):
        J = rng.normal(size=(6, rng.integers(6, 9)))
        singular = np.linalg.svd(J, compute_uv=False)
        assert manipulability(J) == pytest.approx(singular[-1] / singular[0], abs=1e-7)
    assert manipulability(np.diag([1.0, 1, 1, 1, 1, 0])) == 0.0
    assert manipulability(np.eye(6)) == pytest.approx(1.0)


def test_a_chain_that_does_not_fit_is_refused():
    with pytest.raises(ChainError, match="known: 'fetch'"):
        ArmChain.from_robot(dataclasses.replace(FETCH, closed_form_ik="nonesuch"))
    with pytest.raises(ChainError, match="closed form 'fetch' needs"):
        ArmChain.from_robot(dataclasses.replace(FETCH, tcp_offset=(0.1, 0.02, 0.0)))
    slide = FETCH.chain[0]._replace(axis="x")
    with pytest.raises(ChainError, match="slide along z"):
        ArmChain.from_robot(dataclasses.replace(FETCH, chain=(slide, *FETCH.chain[1:])))
    with pytest.raises(ChainError, match=r"shape \(8,\)"):
        forward(CHAIN, np.zeros(7))


def test_angles_and_rotation_vectors_are_those_of_the_c_library_and_of_scipy() -> None:
    """`np.arctan2` has other last bits with AVX-512, and with it what is computed from angles."""
    rng = np.random.default_rng(0)
    sines, cosines = rng.uniform(-3, 3, (2, 1000))
    assert arctan2(sines, cosines).tolist() == list(map(math.atan2, sines, cosines))
    turns = Rotation.random(200, rng=rng)
    assert np.allclose(rotation_vectors(turns.as_matrix()), turns.as_rotvec(), atol=1e-9)
    assert np.allclose(rotations_by(turns.as_rotvec()), turns.as_matrix(), atol=1e-12)
