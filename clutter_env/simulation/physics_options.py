"""MuJoCo's settings under which objects stand, sleep and are held."""

from __future__ import annotations

import mujoco

from clutter_env.config import TIMESTEP

__all__ = ["set_physics"]

_SLEEP_TOLERANCE = 5e-3
"""[m/s] Objects slower than this for 20 ms sleep; one that tips from rest is faster unless within 2° of balance."""
_WRONG_SPARSE_FACTOR = "4.0.0"
"""The MuJoCo version whose sparse Cholesky factor merges rows that have different descendants (mended in 4.0.1, issue
3767). In one contact-rich episode of a hundred its Newton solver then stops at its limit of iterations with forces far
from the solution, and an object that is pressed against another gets hundreds of rad/s."""


def set_physics(option: mujoco.MjOption) -> None:
    """The settings under which side grasps hold: elliptic cone, impratio 10, stiff pads; bodies at rest sleep."""
    option.timestep = TIMESTEP
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10
    option.sleep_tolerance = _SLEEP_TOLERANCE
    option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    if mujoco.mj_versionString() == _WRONG_SPARSE_FACTOR:
        option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
