"""Objects of a simulation come to rest before it is read, the robot held still."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from assets.robots import RobotSpec
from planners.scene.mujoco_reading import robot_bodies
from planners.scene.solid import SceneError

_SLOW, _LONG = 0.005, 0.2
"""[m/s], [rad/s] below which everything must stay for so long [s] to be at rest."""
_MOVED = 0.001
"""[m] An object that has moved less is not named."""


@dataclass(frozen=True, eq=False)
class Settled:
    """A state in which objects rest, and how far they moved.

    Attributes:
        data: a copy of the state that was given, at the same time, with all velocities 0.
        moved: by the names of bodies with a free joint, how far [m] their origins moved; those under a millimetre are
            left out.
        is_at_rest: whether everything came to rest in the time given.
    """

    data: mujoco.MjData
    moved: dict[str, float]
    is_at_rest: bool

    def __str__(self) -> str:
        lines = [f"{name}: moved by {1000 * distance:.0f} mm" for name, distance in self.moved.items()]
        return "\n".join((*(lines or ["nothing moved"]), *["not yet at rest"] * (not self.is_at_rest)))


def settle(model: mujoco.MjModel, data: mujoco.MjData, robot: RobotSpec, seconds: float = 5.0) -> Settled:
    """Let objects fall and come to rest; the same state always ends in the same one.

    Args:
        model: as made by `prepare`: with the contacts that an execution has.
        data: the state; it is not written.
        robot: whose joints stay where they are.
        seconds: simulated time [s] after which it ends even if something still moves.

    Raises:
        SceneError: the model lacks the robot, or the time is not positive.
    """
    if not (np.isfinite(seconds) and seconds > 0):
        raise SceneError(f"seconds={seconds!r} is not valid; it must be a time [s]")
    state, own = copy.copy(data), np.array(sorted(robot_bodies(model, robot)))
    joints = np.flatnonzero(np.isin(model.jnt_bodyid, own))  # slides and hinges alone: of one number each
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
