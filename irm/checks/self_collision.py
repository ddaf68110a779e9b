"""Whether a configuration of an arm in a MuJoCo model is free of self-collision. This module needs the simulator."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from irm.arm.chain import ArmChain
from irm.arm.reading.collision_pairs import body_name

__all__ = ["SelfCollision"]

Floats = NDArray[np.float64]


class SelfCollision:
    """Whether a configuration is free of self-collision: `is_free` of `irm.verify`.

    Only the pairs in `chain.self_collisions` count; everything else in the model is ignored. Joints that are not the
    arm's stay at their initial positions.

    Example:
        is_free = SelfCollision(model, chain)
        verify(chain, placement, poses_of, is_free)
    """

    def __init__(self, model: mujoco.MjModel, chain: ArmChain) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._moving = [k for k, name in enumerate(chain.joints) if name]
        self._columns = [model.joint(chain.joints[k]).qposadr[0] for k in self._moving]
        self._pairs = {frozenset(pair) for pair in chain.self_collisions}

    def __call__(self, _base: Floats, q: Floats) -> bool:
        """Whether no pair of bodies penetrates in the configuration `q` (1 + n,); the base pose does not matter."""
        self._data.qpos[self._columns] = q[self._moving]
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        contacts = self._data.contact
        bodies = self._model.geom_bodyid[contacts.geom[contacts.dist < 0.0]]
        return not any(frozenset(body_name(self._model, body) for body in pair) in self._pairs for pair in bodies)
