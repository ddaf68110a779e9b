"""Arms of the tests, and slow references that share no code with the maps."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from assets.robots import FETCH
from irm.chain import ArmChain, chain_arrays
from irm.ik.closed_form import ik_pan
from irm.ik.numerical import refine
from irm.ik.solvers import all_solutions
from irm.kinematics import arm_jacobian, condition, fk_frames
from irm.rotations import rotation

FOLDER = Path(__file__).resolve().parents[1] / "data" / "arms"
APPROACH = {"panda": "z", "ur5e": "z", "gen3": "z", "pr2_arm": "x"}
"""Axis of the site `tcp` along which each gripper of a file there approaches."""
CHAIN = ArmChain.from_robot(FETCH)
ARM = chain_arrays(CHAIN)
PATH = np.array([(-0.10, 0, 0), (-0.05, 0, 0), (0, 0, 0), (0, 0, 0.05), (0, 0, 0.10)])
"""Approach, grasp and lift: offsets from a target in the approach frame [m]."""


def arm_model(name):
    return mujoco.MjModel.from_xml_path(str(FOLDER / f"{name}.xml"))


def arm_chain(name):
    return ArmChain.from_mjcf(FOLDER / f"{name}.xml", "base", "tcp", APPROACH[name])


def jacobian(chain, q):
    """(6, n) of the TCP with respect to the arm's joints, linear rows first, in the base frame."""
    R, p, J = np.empty((chain.size + 1, 3, 3)), np.empty((chain.size + 1, 3)), np.empty((6, chain.size - 1))
    fk_frames(chain.offsets, chain.axes, chain.tip, np.array(q, dtype=float), R, p)
    arm_jacobian(chain.axes, R, p, J)
    return J


def manipulability(J):
    """μ of a Jacobian, by the kernel of the maps."""
    return condition(np.ascontiguousarray(J, dtype=float), np.empty((6, 6)), np.empty(6), np.empty(6))


def inverse(chain, T, torsos, angles):
    """Every solution for a pose (4, 4) on a grid of the two free parameters: (k, 1 + n)."""
    return all_solutions(chain, T, np.atleast_1d(torsos), np.atleast_1d(angles))


def solve(chain, T, seeds):
    """Solutions for a pose (4, 4) by iteration from each of the configurations (m, 1 + n)."""
    arm, R, p = chain_arrays(chain), T[:3, :3].copy(), T[:3, 3].copy()
    return np.array([q for q in np.atleast_2d(np.array(seeds, dtype=float)) if refine(arm, R, p, q)]).reshape(
        -1, chain.size
    )


def in_world(target, yaw, offsets=PATH):
    """(m, 3) waypoints of a path that approaches a target with a yaw."""
    return np.asarray(target) + np.asarray(offsets) @ rotation(yaw, 0.0, 0.0).T


def in_base(base, T_world_tcp):
    """T_base_tcp of TCP poses in the world, for a base x, y, yaw."""
    T_world_base = np.eye(4)
    T_world_base[:3, :3], T_world_base[:2, 3] = rotation(base[2], 0.0, 0.0), base[:2]
    return np.linalg.inv(T_world_base) @ T_world_tcp


def random_poses(chain, count, rng, radius=None):
    """T_base_tcp (count, 4, 4): positions in the ball of the stretched arm, any orientation."""
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction *= (radius or chain.reach) * rng.random((count, 1)) ** (1 / 3)
    T = np.tile(np.eye(4), (count, 1, 1))
    Q, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    T[:, :3, :3] = Q * np.linalg.det(Q)[:, None, None]
    T[:, :3, 3] = chain.shoulder + (0.0, 0.0, (chain.lower[0] + chain.upper[0]) / 2) + direction
    return T


def random_configurations(chain, count, rng, near_limits=False):
    """(count, 1 + n) within the limits and one turn; with `near_limits`, joints are often within 1% of a limit."""
    side = rng.uniform(-1, 1, (count, chain.size))
    if near_limits:
        at_limit = rng.random(side.shape) < 0.6
        side = np.where(at_limit, np.sign(side) * (1 - 0.01 * rng.random(side.shape)), side)
    return (chain.lower + chain.upper) / 2 + side * np.minimum((chain.upper - chain.lower) / 2, np.pi)


def is_reached(T_base_tcp, torsos=36, pans=361):
    """Brute force: whether Fetch reaches a pose with any pan angle and torso height of a fine grid."""
    rows, approach = np.empty((2, 5)), np.ascontiguousarray(T_base_tcp[:3, 0])
    for torso in np.linspace(CHAIN.lower[0], CHAIN.upper[0], torsos):
        wrist = T_base_tcp[:3, 3] - CHAIN.links[6] * approach - [CHAIN.links[0], 0.0, CHAIN.links[1] + torso]
        if np.linalg.norm(wrist - [0, 0, CHAIN.links[3]]) > CHAIN.links[2:6].sum():
            continue
        for pan in np.linspace(CHAIN.lower[1], CHAIN.upper[1], pans):
            if ik_pan(ARM, approach, wrist, np.cos(pan), np.sin(pan), rows):
                return True
    return False
