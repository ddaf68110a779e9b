"""A Panda that robosuite's operational-space controller moves, in somebody's environment: a `planners` `Controller`.

The action moves the gripper: how the arm follows is the controller's to say. So the poses of the TCP are played, and a
plan may begin wherever the arm is.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.bridges.osc import Lead, OscFollower
from clutter_env.bridges.remote import BridgeError, Remote
from planners import RobotState, insert_robot, tcp_pose

Array = NDArray[np.float64]

OPENING = 0.08
"""[m] of the Panda's gripper."""
BESIDE = 0.01
"""[m] that the TCP may be behind on lines to and from an object: fingers 12 mm beside it come down on it else."""
_STILL = 0.004
"""[m] by which the gripper's opening may differ from the one wanted, before it is moved."""
_SAME = 0.02
"""[m] at most from the point that robosuite's controller moves to the TCP of our Panda."""
_WIDTH = {mujoco.mjtJoint.mjJNT_FREE: 7, mujoco.mjtJoint.mjJNT_BALL: 4}
"""Number of positions of the joints that have more than one."""


class OscTask:
    """An episode that is played by changes of the gripper's pose: a `Controller`.

    Attributes:
        dt: [s] of one step.
        done: the time is up.
        is_solved: what the environment's own check said after the last step.
        steps: taken so far.
        model: the environment's, with our robot in place of theirs.
        robot: ours.
    """

    dt = 0.05

    def __init__(
        self,
        remote: Remote,
        start: dict[str, Any],
        spec: mujoco.MjSpec,
        robot: RobotSpec,
        place: tuple[Array, float],
        finger_steps: int,
        closing_steps: int = 0,
    ) -> None:
        """Put our robot into the environment's model.

        Args:
            remote: the worker, whose `step` takes six numbers for the arm and one for the gripper.
            start: what its `reset` told.
            spec: the environment's model, as the planner is to see it.
            robot: ours. Its home becomes that of the environment's arm.
            place: x, y, yaw of its base [m, rad], and the height of its lift [m].
            finger_steps: of the environment in which its gripper is told to open or close all the way.
            closing_steps: in which it does, for plans. 0: the same.
        """
        self._remote, self.steps, self._finger_steps = remote, 0, finger_steps
        self._base, lift = place
        self.robot = replace(
            robot,
            home=(lift, *start["home"]),
            plans_torso=False,
            max_finger_velocity=OPENING / 2 / (self.dt * (closing_steps or finger_steps)),
        )
        self._lift = np.array([lift])
        self.model = model = insert_robot(spec, self.robot, self._base, without=[start["root"]])
        theirs = start["joints"]
        self._others = [
            (theirs[joint.name], int(joint.qposadr[0]), _WIDTH.get(mujoco.mjtJoint(int(joint.type[0])), 1))
            for joint in (model.joint(k) for k in range(model.njnt))
            if joint.name in theirs
        ]
        self._arm = [theirs[name] for name in start["arm"]]
        self._columns = [model.joint(name).qposadr[0] for name in self.robot.arm_joints]
        self._theirs = [theirs[name] for name in start["fingers"]]
        self._fingers = [model.joint(name).qposadr[0] for name in self.robot.finger_joints]
        self._most, self._lag = np.array(start["most"]), start["lag"] / self.dt
        self._qpos = model.qpos0.copy()
        self._qpos[model.joint(self.robot.torso_joint).qposadr[0]] = lift
        self._read(start)
        self._begin()

    def observe(self) -> Array:
        """(nq,) joint positions in our model."""
        for theirs, ours, width in self._others:
            self._qpos[ours : ours + width] = self._state[theirs : theirs + width]
        self._qpos[self._columns] = self._state[self._arm]
        self._qpos[self._fingers] = self.robot.finger_position(self._opening)
        return self._qpos

    def act(self, configuration: Array, opening: float) -> None:
        """One step of the environment: towards a pose of the gripper, and ahead of it by as much as it stays behind."""
        wanted = tcp_pose(self.robot, RobotState(configuration[:3], configuration[3:], 0.0))
        self._step(self._lead.action(wanted, self._tcp()), self._grip(opening))

    def follower(self, start: dict[str, Any], name: str) -> OscFollower:
        """A model of the controller, with the environment's own arm, which is at rest now.

        Raises:
            BridgeError: its arm, of a robot of that name, is no Panda's.
        """
        spec = mujoco.MjSpec.from_string(start["xml"])
        for body in spec.worldbody.bodies:
            if body.name != start["root"]:
                spec.delete(body)
        model = spec.compile()
        data = mujoco.MjData(model)
        for joint in (model.joint(number) for number in range(model.njnt)):
            data.qpos[joint.qposadr[0]] = self._state[start["joints"][joint.name]]
        mujoco.mj_kinematics(model, data)
        site, T_world_site = data.site(start["site"]), np.eye(4)
        T_world_site[:3, :3], T_world_site[:3, 3] = site.xmat.reshape(3, 3), site.xpos
        T_site_tcp = np.linalg.inv(T_world_site) @ self._tcp()
        if np.linalg.norm(T_site_tcp[:3, 3]) > _SAME:
            raise BridgeError(f"the arm of the robot {name!r} is not that of a Panda")
        return OscFollower(
            data,
            start["arm"],
            start["site"],
            np.array(start["elbow"]),
            self._base,
            T_site_tcp,
            lift=float(self._lift[0]),
            dt=self.dt,
            stiffness=start["stiffness"],
            lag=self._lag,
            most=self._most,
            strength=np.array(start["strength"]),
            line_tolerance=BESIDE,
        )

    def _begin(self) -> None:
        """From here on the gripper counts as open, and the arm as at rest."""
        self._commanded, self._lead = OPENING / 2, Lead(self._tcp(), self._lag, self._most)

    def _read(self, answer: dict[str, Any]) -> None:
        self._state = np.array(answer["qpos"])
        self._opening = float(np.ptp(self._state[self._theirs]))
        self.is_solved, self.done = answer["is_success"], answer["done"]

    def _tcp(self) -> Array:
        q = np.append(self._lift, self._state[self._arm])
        return tcp_pose(self.robot, RobotState(self._base, q, 0.0))

    def _step(self, action: Array, grip: float) -> None:
        self._read(self._remote("step", action=[*action, grip]))
        self.steps += 1

    def _grip(self, opening: float) -> float:
        """-1 opens the gripper by a step, 1 closes it, 0 leaves it. A held object is pressed."""
        holds = self._commanded == 0 and opening < self._opening + _STILL
        if opening < _STILL or holds:
            way = 1.0
        else:
            way = float(np.sign(self._commanded - opening)) if abs(self._commanded - opening) > _STILL else 0.0
        self._commanded = float(np.clip(self._commanded - way * OPENING / self._finger_steps, 0.0, OPENING))
        return way
