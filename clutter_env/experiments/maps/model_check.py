"""Robots by name, and comparisons of a chain with its MJCF file."""

from __future__ import annotations

import importlib
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec, robot
from irm.arm.kinematics import ArmChain, forward
from irm.arm.mjcf import APPROACHES
from irm.errors import ChainError

__all__ = ["check_chain", "checked_chain", "compare_with_model", "robot_by_name"]

Floats = NDArray[np.float64]

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
    compare_with_model(model, ArmChain.from_robot(robot), robot.base_body, robot.tcp_site, np.eye(3))


def checked_chain(model_file: Path, base: str, tip: str, approach: str) -> ArmChain:
    """The arm of any MJCF file, after its TCP poses were compared with those of MuJoCo in random configurations.

    Raises:
        ChainError: there is no such arm, or the poses differ.
    """
    chain = ArmChain.from_mjcf(model_file, base, tip, approach)
    compare_with_model(mujoco.MjModel.from_xml_path(str(model_file)), chain, base, tip, APPROACHES[approach])
    return chain


def compare_with_model(model: mujoco.MjModel, chain: ArmChain, base: str, tip: str, R_tip_tcp: Floats) -> None:
    """Compare the TCP poses of a chain with those of a model, whose tip is turned by `R_tip_tcp`.

    Raises:
        ChainError: they differ by more than rounding.
    """
    data = mujoco.MjData(model)
    moving = [k for k, name in enumerate(chain.joints) if name]
    columns = [model.joint(chain.joints[k]).qposadr[0] for k in moving]
    is_site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, tip) >= 0
    rng = np.random.default_rng(0)
    largest = 0.0
    for _ in range(CONFIGURATIONS):
        q = rng.uniform(np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi))
        data.qpos[columns] = q[moving]
        mujoco.mj_kinematics(model, data)
        frame, R_base = data.site(tip) if is_site else data.body(tip), data.body(base).xmat.reshape(3, 3)
        T_base_tcp = np.eye(4)
        T_base_tcp[:3, 3] = R_base.T @ (frame.xpos - data.body(base).xpos)
        T_base_tcp[:3, :3] = R_base.T @ frame.xmat.reshape(3, 3) @ R_tip_tcp
        largest = max(largest, float(np.abs(T_base_tcp - forward(chain, q)).max()))
    if largest > TOLERANCE:
        raise ChainError(
            f"the chain of {chain.robot} does not agree with its MJCF file: TCP poses differ by {largest:.3g} "
            "(m, or entries of rotation matrices)"
        )
