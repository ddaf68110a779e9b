"""MuJoCo's settings under which objects stand, sleep and are held."""

from __future__ import annotations

import mujoco

from clutter_env.config import TIMESTEP

_SLEEP_TOLERANCE = 5e-3
"""[m/s] Objects slower than this for 20 ms sleep; one that tips from rest is faster unless within 2° of balance."""
_WRONG_SPARSE_FACTOR = "4.0.0"
"""The MuJoCo version whose sparse Cholesky factor merges rows that have different descendants (mended in 4.0.1; issue
3767). Where the robot wedges objects in, its Newton solver can then stop at its limit of iterations, with forces far
from the solution, and an object gets hundreds of rad/s."""
_ARENA = 2**24
"""[bytes] for contacts and solver of a scene without objects, as MuJoCo itself reserves."""
_ARENA_PER_OBJECT = 2**19
"""[bytes]"""
_ROWS_PER_OBJECT = 100
"""Constraint rows of an object; 90 when sixty objects are awake in one place."""
_ROBOT_DOF = 24
"""At least the robot's degrees of freedom."""


def set_physics(spec: mujoco.MjSpec, num_objects: int) -> None:
    """The settings under which side grasps hold: elliptic cone, impratio 10, stiff pads; bodies at rest sleep."""
    option = spec.option
    option.timestep = TIMESTEP
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10
    option.sleep_tolerance = _SLEEP_TOLERANCE
    option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    if mujoco.mj_versionString() == _WRONG_SPARSE_FACTOR:
        option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        spec.memory = _dense_arena(num_objects)


def _dense_arena(num_objects: int) -> int:
    """Bytes for the dense Jacobian twice, once in the order of islands; pages that are never written take no memory."""
    rows, columns = _ROWS_PER_OBJECT * num_objects, 6 * num_objects + _ROBOT_DOF
    return _ARENA + _ARENA_PER_OBJECT * num_objects + 2 * 8 * rows * columns
