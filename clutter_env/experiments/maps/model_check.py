"""Robots by name, and comparisons of a chain with its MJCF file."""

from __future__ import annotations

import importlib
from pathlib import Path

import mujoco
import numpy as np

from assets.robots import RobotSpec, robot
from clutter_env.experiments.maps.tip_model import TipModel
from irm.arm.kinematics import ArmChain, forward
from irm.arm.mjcf import APPROACHES
from irm.errors import ChainError

__all__ = ["check_chain", "checked_arm", "compare_with_model", "robot_by_name"]

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
    compare_with_model(TipModel(model, ArmChain.from_robot(robot), robot.base_body, robot.tcp_site, np.eye(3)))


def checked_arm(mjcf: Path, base: str, tip: str, approach: str) -> TipModel:
    """The arm of any MJCF file, after its TCP poses were compared with those of MuJoCo in random configurations.

    Raises:
        ChainError: there is no such arm, or the poses differ.
    """
    chain = ArmChain.from_mjcf(mjcf, base, tip, approach)
    arm = TipModel(mujoco.MjModel.from_xml_path(str(mjcf)), chain, base, tip, APPROACHES[approach])
    compare_with_model(arm)
    return arm


def compare_with_model(arm: TipModel) -> None:
    """Compare the TCP poses of a chain with those of MuJoCo.

    Raises:
        ChainError: they differ by more than rounding.
    """
    chain, rng = arm.chain, np.random.default_rng(0)
    configurations = rng.uniform(
        np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi), (CONFIGURATIONS, chain.size)
    )
    largest = max(float(np.abs(arm.tcp_pose(q) - forward(chain, q)).max()) for q in configurations)
    if largest > TOLERANCE:
        raise ChainError(
            f"the chain of {chain.robot} does not agree with its MJCF file: TCP poses differ by {largest:.3g} "
            "(m, or entries of rotation matrices)"
        )
