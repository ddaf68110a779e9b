"""Kinematics against MuJoCo, and laws of the closed form."""

import dataclasses

import mujoco
import numpy as np
import pytest

from assets.robots import FETCH
from irm.chain import ArmChain, chain_arrays
from irm.errors import ChainError
from irm.ik.closed_form import ik_pan, inverse
from irm.kinematics import forward, jacobian, manipulability

CHAIN = ArmChain.from_robot(FETCH)
ARM = chain_arrays(CHAIN)
ROLLS = np.linspace(-np.pi, np.pi, 72, endpoint=False)


def random_configuration(rng: np.random.Generator) -> np.ndarray:
    lower, upper = CHAIN.lower.copy(), CHAIN.upper.copy()
    lower[[3, 5, 7]], upper[[3, 5, 7]] = -np.pi, np.pi
    return rng.uniform(lower, upper)


@pytest.fixture(scope="module")
def simulated():
    model = mujoco.MjModel.from_xml_path(str(FETCH.mjcf_path))
    return model, mujoco.MjData(model)


def set_configuration(model, data, q):
    for link, value in zip(FETCH.chain, q, strict=True):
        data.qpos[model.joint(link.joint).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)


def test_forward_and_jacobian_are_those_of_the_model(simulated):
    model, data = simulated
    rng = np.random.default_rng(0)
    site = model.site(FETCH.tcp_site).id
    columns = [model.joint(name).dofadr[0] for name in FETCH.arm_joints]
    for _ in range(50):
        q = random_configuration(rng)
        set_configuration(model, data, q)
        T = forward(CHAIN, q)
        np.testing.assert_allclose(T[:3, 3], data.site_xpos[site], atol=1e-9)
        np.testing.assert_allclose(T[:3, :3], data.site_xmat[site].reshape(3, 3), atol=1e-9)
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, linear, angular, site)
        np.testing.assert_allclose(jacobian(CHAIN, q), np.vstack([linear, angular])[:, columns], atol=1e-9)


def test_every_inverse_solution_reaches_the_pose_within_the_limits():
    rng = np.random.default_rng(1)
    solved = 0
    for _ in range(30):
        T = forward(CHAIN, random_configuration(rng))
        for q in inverse(CHAIN, T, [0.05, 0.2, 0.35], ROLLS):
            np.testing.assert_allclose(forward(CHAIN, q), T, atol=1e-6)
            assert np.all(q >= CHAIN.lower)
            assert np.all(q <= CHAIN.upper)
            assert np.all(np.abs(q[[3, 5, 7]]) <= np.pi + 1e-9)
            solved += 1
    assert solved > 500


def test_the_configuration_of_a_pose_is_among_its_solutions():
    rng = np.random.default_rng(2)
    for _ in range(200):
        q = random_configuration(rng)
        found = inverse(CHAIN, forward(CHAIN, q), [q[0]], [q[3]])
        difference = np.abs(found - q)
        difference[:, [3, 5, 7]] = np.minimum(difference[:, [3, 5, 7]], 2 * np.pi - difference[:, [3, 5, 7]])
        assert len(found) <= 8
        assert difference.max(axis=1).min() < 1e-4


def test_solving_for_the_pan_agrees_with_solving_for_the_roll():
    rng = np.random.default_rng(3)
    out = np.empty((2, 5))
    for _ in range(200):
        q = random_configuration(rng)
        T = forward(CHAIN, q)
        approach = T[:3, 0]
        wrist = T[:3, 3] - CHAIN.links[6] * approach - [CHAIN.links[0], 0, CHAIN.links[1] + q[0]]
        count = ik_pan(ARM, approach, wrist, np.cos(q[1]), np.sin(q[1]), out)
        assert count >= 1
        for row in out[:count]:
            np.testing.assert_allclose(forward(CHAIN, [q[0], q[1], *row, 0.0])[:3, 3], T[:3, 3], atol=1e-6)
            np.testing.assert_allclose(forward(CHAIN, [q[0], q[1], *row, 0.0])[:3, 0], approach, atol=1e-6)


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
