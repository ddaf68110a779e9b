"""Settling of a simulation's objects with the robot held still, before the scene is read."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from assets.robots import RobotSpec
from planners.scene.mujoco_reading import robot_bodies
from planners.scene.solid import SceneError

_SLOW, _LONG = 0.005, 0.2
"""Largest velocity at rest [m/s], [rad/s], and the time for which all velocities must stay below it [s]."""
_MOVED = 0.001
"""[m] Least motion of an object that is reported."""


@dataclass(frozen=True, eq=False)
class Settled:
    """State with objects at rest, and the distances that they moved.

    Attributes:
        data: a copy of the given state, at the same time, with all velocities 0.
        moved: distances that the origins of bodies with a free joint moved, by name [m]. Distances under a millimetre
            are left out.
        is_at_rest: whether all objects came to rest in the given time.
    """

    data: mujoco.MjData
    moved: dict[str, float]
    is_at_rest: bool

    def __str__(self) -> str:
        lines = [f"{name}: moved by {1000 * distance:.0f} mm" for name, distance in self.moved.items()]
        return "\n".join((*(lines or ["nothing moved"]), *["not yet at rest"] * (not self.is_at_rest)))


def settle(model: mujoco.MjModel, data: mujoco.MjData, robot: RobotSpec, seconds: float = 5.0) -> Settled:
    """Let objects fall and come to rest. The result is deterministic.

    Args:
        model: model made by `prepare`, with the contacts of an execution.
        data: the state, which is not modified.
        robot: robot, whose joints are held still.
        seconds: most simulated time [s], even if objects still move.

    Raises:
        SceneError: the model lacks the robot, or the time is not positive.
    """
    if not (np.isfinite(seconds) and seconds > 0):
        raise SceneError(f"seconds={seconds!r} is not valid; it must be a time [s]")
    state, own = copy.copy(data), np.array(sorted(robot_bodies(model, robot)))
    joints = np.flatnonzero(np.isin(model.jnt_bodyid, own))  # only slides and hinges, of one coordinate each
    places, speeds = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    still, started = state.qpos[places].copy(), float(state.time)
    state.qvel[:], state.qacc_warmstart[:] = 0.0, 0.0
    rested, is_at_rest = 0.0, False
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, state)
        state.qpos[places], state.qvel[speeds] = still, 0.0
        rested = rested + model.opt.timestep if np.abs(state.qvel).max(initial=0.0) < _SLOW else 0.0
        if is_at_rest := rested >= _LONG:
            break
    state.qvel[:], state.qacc_warmstart[:], state.time = 0.0, 0.0, started
    mujoco.mj_forward(model, state)
    return Settled(state, _distances(model, data, state), is_at_rest)


def _distances(model: mujoco.MjModel, before: mujoco.MjData, after: mujoco.MjData) -> dict[str, float]:
    found = {}
    for joint in np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)).tolist():
        first, body = int(model.jnt_qposadr[joint]), int(model.jnt_bodyid[joint])
        distance = float(np.linalg.norm(after.qpos[first : first + 3] - before.qpos[first : first + 3]))
        if distance > _MOVED:
            found[str(model.body(body).name) or f"body {body}"] = distance
    return found
