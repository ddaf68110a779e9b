"""Robots by name, and a comparison of a robot's chain with its MJCF file."""

from __future__ import annotations

import importlib

import mujoco
import numpy as np

from assets.robots import RobotSpec, robot
from irm.arm.kinematics import ArmChain, forward
from irm.errors import ChainError

__all__ = ["check_chain", "robot_by_name"]

CONFIGURATIONS = 200
TOLERANCE = 1e-6
"""[m], and the same number for entries of rotation matrices: two correct chains differ by rounding only."""


def robot_by_name(name: str) -> RobotSpec:
    """A robot of the project by its name, or the `RobotSpec` that module:NAME refers to.

    Raises:
        ValueError: there is no such robot, module or name, or it is not a `RobotSpec`.
    """
    if ":" not in name:
        return robot(name)
    module, attribute = name.split(":", 1)
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"there is no robot {name!r}: {error}") from error
    if not isinstance(found, RobotSpec):
        raise ValueError(f"{name} is a {type(found).__name__}, not a RobotSpec")
    return found


def check_chain(robot: RobotSpec) -> None:
    """Compare the TCP poses of the chain and of the MJCF file in random configurations.

    Raises:
        ChainError: they differ.
    """
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    data, chain = mujoco.MjData(model), ArmChain.from_robot(robot)
    columns = [model.joint(link.joint).qposadr[0] for link in robot.chain]
    base, tcp = model.body(robot.base_body).id, model.site(robot.tcp_site).id
    rng = np.random.default_rng(0)
    largest = 0.0
    for _ in range(CONFIGURATIONS):
        q = rng.uniform(np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi))
        data.qpos[columns] = q
        mujoco.mj_kinematics(model, data)
        R_base = data.xmat[base].reshape(3, 3)
        T_base_tcp = np.eye(4)
        T_base_tcp[:3, 3] = R_base.T @ (data.site_xpos[tcp] - data.xpos[base])
        T_base_tcp[:3, :3] = R_base.T @ data.site_xmat[tcp].reshape(3, 3)
        largest = max(largest, float(np.abs(T_base_tcp - forward(chain, q)).max()))
    if largest > TOLERANCE:
        raise ChainError(
            f"the chain of {robot.name} does not agree with its MJCF file: TCP poses differ by {largest:.3g} "
            "(m, or entries of rotation matrices)"
        )
