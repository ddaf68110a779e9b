"""Objects that are toppled, or moved by hand."""

from __future__ import annotations

import mujoco
import numpy as np

from clutter_env.envs.retrieve import RetrieveEnv

TOPPLING_SPEED, TOPPLING_SPIN = 2.0, 16.0
"""[m/s], [rad/s] Bounds of the objects' random velocities; nine of ten objects topple."""


def topple_objects(env: RetrieveEnv, rng: np.random.Generator) -> None:
    """Give every object a random velocity in the horizontal plane and a random spin, and wake it."""
    bounds = np.array([TOPPLING_SPEED, TOPPLING_SPEED, 0.0, *[TOPPLING_SPIN] * 3])
    velocities = rng.uniform(-1, 1, (env.world.index.num_objects, 6)) * bounds
    env.data.qvel[env.world.index.object_dof] = velocities.ravel()
    wake(env.model, env.data)


def wake(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Wake all bodies, as setting a state does; a sleeping one does not notice that its pose or velocity is written."""
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    mujoco.mj_setState(model, data, state, kind)
