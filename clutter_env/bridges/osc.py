"""robosuite's operational-space controller with the physics of its arm alone: how it follows its gripper."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from planners.motion.tcp_following import ON_THE_WAY

Array = NDArray[np.float64]

_SUBSTEPS = 5
"""Of one step of the environment."""
_FADING = 0.8
"""Of the lead that is left a step later."""
_ELBOW_STIFFNESS = 10.0
"""[1/s²] with which the controller draws the joints to their start, as far as the gripper's pose leaves them free."""


def change(start: Array, end: Array) -> Array:
    """(6,) from one pose (4, 4) to another, in the world: [m], and a rotation vector [rad]."""
    turn = Rotation.from_matrix(end[:3, :3] @ start[:3, :3].T).as_rotvec()
    return np.concatenate((end[:3, 3] - start[:3, 3], turn))


class Lead:
    """Actions that keep the gripper where it is wanted, although the controller stays behind.

    The goal of an action is ahead of what is wanted by as much as spring and damper stay behind at that speed. Where
    the plan waits for the gripper, the lead fades: taken away at once it would halve the speed, step by step.
    """

    def __init__(self, pose: Array, lag: float, most: Array) -> None:
        """Begin at rest at a pose (4, 4).

        Args:
            pose: of the gripper.
            lag: steps by which the controller stays behind.
            most: (6,) [m], [rad] that an action of 1 means.
        """
        self._before, self._speed, self._lag, self._most = pose, np.zeros(6), lag, most

    def action(self, wanted: Array, now: Array) -> Array:
        """(6,) in [-1, 1]: from the pose (4, 4) that the gripper has now towards the one wanted after this step."""
        is_waiting = np.array_equal(wanted, self._before)
        self._speed = _FADING * self._speed if is_waiting else change(self._before, wanted)
        self._before = wanted
        action = (change(now, wanted) + self._lag * self._speed) / self._most
        for part in (action[:3], action[3:]):  # slower, but in the same direction
            part /= max(1.0, float(np.abs(part).max()))
        return action


class OscFollower:
    """Predicts in which configurations the arm follows poses of the gripper: a `planners` `TcpFollower`.

    The gripper is drawn to its goal as by a spring with damping, the elbow to where it started, and a joint at its
    limit stays there. Motors have their limits, and air and joints of the model brake. robosuite's links have the
    inertia of far larger bodies. Its air acts on them with as much torque as the motors of the wrist have.
    """

    def __init__(
        self,
        data: mujoco.MjData,
        joints: list[str],
        site: str,
        start: Array,
        base: Array,
        T_site_tcp: Array,
        *,
        lift: float,
        dt: float,
        stiffness: float,
        lag: float,
        most: Array,
        strength: Array,
        line_tolerance: float = ON_THE_WAY,
    ) -> None:
        """Make a model of the controller.

        Args:
            data: of a model that has the arm. Everything else in it stays as it is.
            joints: of the arm.
            site: of which the controller moves the pose.
            start: (n,) [rad] configuration to which the controller draws the elbow.
            base: (3,) x, y, z [m] of the frame in which poses of the TCP are given.
            T_site_tcp: (4, 4) of the TCP in the frame of the site.
            lift: [m] first joint of the configurations, which stays.
            dt: [s] of one step.
            stiffness: [1/s²] of the gripper's spring. The damping is critical.
            lag: steps by which the gripper stays behind.
            most: (6,) [m], [rad] that an action of 1 means.
            strength: (n,) [N m] of the motors at most.
            line_tolerance: of the world, see `TcpFollower`.
        """
        model = data.model
        self._model, self._data = model, data
        own = [model.joint(name) for name in joints]
        self._columns = np.array([int(joint.qposadr[0]) for joint in own])
        self._dofs = np.array([int(joint.dofadr[0]) for joint in own])
        self._lower, self._upper = np.array([joint.range for joint in own]).T
        self._site, self._start, self._base, self._T_site_tcp = model.site(site).id, start, base, T_site_tcp
        self._lift, self._dt, self._stiffness, self._lag, self._most = lift, dt, stiffness, lag, most
        self._strength, self.line_tolerance = strength, line_tolerance
        self.reset(np.append(lift, start))

    def reset(self, q: Array) -> None:
        """Start at rest in a configuration (1 + n,)."""
        self._q, self._qd = np.array(q[1:], dtype=float), np.zeros(len(q) - 1)
        self._update()
        self._lead = Lead(self._pose() @ self._T_site_tcp, self._lag, self._most)

    def step(self, T_base_tcp: Array) -> Array:
        """The configuration (1 + n,) one step later, on the way to a pose (4, 4)."""
        wanted = T_base_tcp.copy()
        wanted[:3, 3] += self._base
        now = self._pose()
        action = self._lead.action(wanted, now @ self._T_site_tcp) * self._most
        J, inverse, M = self._dynamics()
        pull, free = _projections(J, inverse)
        weight, brake = self._loads()
        time, start = self._dt / _SUBSTEPS, self._q
        for _ in range(_SUBSTEPS):
            left = action - J @ (self._q - start)
            force = self._stiffness * left - 2 * np.sqrt(self._stiffness) * (J @ self._qd)
            elbow = _ELBOW_STIFFNESS * (self._start - self._q) - 2 * np.sqrt(_ELBOW_STIFFNESS) * self._qd
            torque = np.clip(pull @ force + free @ (M @ elbow) + weight, -self._strength, self._strength)
            self._qd = self._qd + inverse @ (torque - weight + brake) * time
            q = self._q + self._qd * time
            self._q = np.clip(q, self._lower, self._upper)
            self._qd[self._q != q] = 0.0
        self._update()
        return np.append(self._lift, self._q)

    def _update(self) -> None:
        self._data.qpos[self._columns] = self._q
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)

    def _pose(self) -> Array:
        """(4, 4) of the controller's site in the world."""
        pose = np.eye(4)
        pose[:3, :3] = self._data.site_xmat[self._site].reshape(3, 3)
        pose[:3, 3] = self._data.site_xpos[self._site]
        return pose

    def _dynamics(self) -> tuple[Array, Array, Array]:
        """Jacobian (6, n) of the site, inverse and mass matrix (n, n)."""
        J, M = np.empty((6, self._model.nv)), np.empty((self._model.nv, self._model.nv))
        mujoco.mj_crb(self._model, self._data)
        mujoco.mj_jacSite(self._model, self._data, J[:3], J[3:], self._site)
        mujoco.mj_fullM(self._model, self._data, M)
        M = M[np.ix_(self._dofs, self._dofs)]
        return J[:, self._dofs], np.linalg.inv(M), M

    def _loads(self) -> tuple[Array, Array]:
        """(n,) [N m] that the motors have to carry, and of the air and the joints' damping."""
        weight = np.empty(self._model.nv)
        self._data.qvel[self._dofs] = self._qd
        mujoco.mj_comVel(self._model, self._data)
        mujoco.mj_passive(self._model, self._data)
        mujoco.mj_rne(self._model, self._data, 0, weight)
        return weight[self._dofs], np.asarray(self._data.qfrc_passive[self._dofs])


def _projections(J: Array, inverse: Array) -> tuple[Array, Array]:
    """Torques (n, 6) of unit accelerations of the site, position and rotation apart, and the part that does not move it
    (n, n)."""
    inertia = J @ inverse @ J.T
    pull = np.hstack([J[rows].T @ np.linalg.pinv(inertia[rows, rows]) for rows in (slice(0, 3), slice(3, 6))])
    return pull, np.eye(len(inverse)) - J.T @ np.linalg.pinv(inertia) @ J @ inverse
