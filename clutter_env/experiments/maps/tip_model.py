"""The arm of an MJCF model as MuJoCo sees it: TCP poses and Jacobian, sharing no code with `irm`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from irm.arm.chain import ArmChain

__all__ = ["TipModel"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TipModel:
    """A model, the names of base and tip, and the chain whose configurations are set.

    Attributes:
        model: compiled MJCF model.
        chain: its arm, for the names of the joints.
        base: body whose frame is the base frame.
        tip: site or body whose frame, turned by `R_tip_tcp`, is the TCP frame.
        R_tip_tcp: (3, 3) see `irm.arm.mjcf.APPROACHES`.
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
