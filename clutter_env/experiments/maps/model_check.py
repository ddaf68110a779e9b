"""Robots by name, an arm as MuJoCo sees it, and comparisons of a chain with its MJCF file."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.arm_reading import APPROACHES
from assets.robots import RobotSpec, robot
from irm.chain import ArmChain
from irm.kinematics import forward
from irm.errors import ChainError

__all__ = ["TipModel", "check_chain", "checked_arm", "compare_with_model", "robot_by_name"]

Floats = NDArray[np.float64]

CONFIGURATIONS = 200
TOLERANCE = 1e-6
"""[m], and the same number for entries of rotation matrices: two correct chains differ by rounding only."""


@dataclass(frozen=True)
class TipModel:
    """The arm of an MJCF model: TCP poses and Jacobian by MuJoCo, sharing no code with `irm`.

    Attributes:
        model: compiled MJCF model.
        chain: its arm, for the names of the joints.
        base: body whose frame is the base frame.
        tip: site or body whose frame, turned by `R_tip_tcp`, is the TCP frame.
        R_tip_tcp: (3, 3) see `assets.arm_reading.APPROACHES`.
    """

    model: mujoco.MjModel
    chain: ArmChain
    base: str
    tip: str
    R_tip_tcp: Floats

    @cached_property
    def data(self) -> mujoco.MjData:
        """The state that the methods change."""
        return mujoco.MjData(self.model)

    @cached_property
    def _is_site(self) -> bool:
        return bool(mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, self.tip) >= 0)

    def tcp_pose(self, q: Floats) -> Floats:
        """T_base_tcp (4, 4) of a configuration (1 + n,)."""
        for name, value in zip(self.chain.joints, q, strict=True):
            if name:
                self.data.joint(name).qpos = value
        mujoco.mj_kinematics(self.model, self.data)
        base = self.data.body(self.base)
        tip = self.data.site(self.tip) if self._is_site else self.data.body(self.tip)
        R_base = base.xmat.reshape(3, 3)
        T = np.eye(4)
        T[:3, :3] = R_base.T @ tip.xmat.reshape(3, 3) @ self.R_tip_tcp
        T[:3, 3] = R_base.T @ (tip.xpos - base.xpos)
        return T

    def jacobian(self) -> Floats:
        """(6, 1 + n) of the TCP in the base frame, at the last configuration of `tcp_pose`; 0 for a lift it lacks."""
        mujoco.mj_comPos(self.model, self.data)
        linear, angular = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        if self._is_site:
            mujoco.mj_jacSite(self.model, self.data, linear, angular, self.model.site(self.tip).id)
        else:
            mujoco.mj_jacBody(self.model, self.data, linear, angular, self.model.body(self.tip).id)
        R_base = self.data.body(self.base).xmat.reshape(3, 3)
        J = np.zeros((6, self.chain.size))
        for k, name in enumerate(self.chain.joints):
            if name:
                column = self.model.joint(name).dofadr[0]
                J[:3, k], J[3:, k] = R_base.T @ linear[:, column], R_base.T @ angular[:, column]
        return J


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
