"""What the robot knows without knowing the world: its own joints, its gripper, and where it believes objects to be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.expert.monitor import Snapshot
from planners.motion.base import unwrap_yaw
from planners.scene import Body, HeldObject
from planners.scene.bodies import pose_matrix

Array = NDArray[np.float64]

_PRESSED = 0.004
"""[m] by which fingers that press on something are farther apart than commanded, at least."""
_AROUND = 0.03
"""[m] that the TCP may be outside an object that the fingers have closed on."""


@dataclass(frozen=True, eq=False)
class RobotReading:
    """One control step: `drive` (4 + n,) base x, y [m], yaw [rad], torso, arm; T_world_base, T_world_tcp (4, 4);
    `width` and `commanded` [m] between the finger pads; `head` (2,) pan and tilt [rad], or (0,) if it does not move."""

    drive: Array
    T_world_base: Array
    T_world_tcp: Array
    width: float
    commanded: float
    head: Array

    @classmethod
    def of(cls, observation: Mapping[str, Any], near_yaw: float = 0.0) -> RobotReading:
        """That of an observation's entries `robot`, `tcp`, `gripper` and `head`; the yaw within half a turn of one."""
        robot, tcp, gripper = (np.asarray(observation[name], float) for name in ("robot", "tcp", "gripper"))
        joints = (len(robot) - 7) // 2  # positions of torso and arm, then as many velocities after the base's three
        x, y, sine, cosine = robot[:4]
        T_world_base = pose_matrix((x, y, 0.0), ((cosine, -sine, 0.0), (sine, cosine, 0.0), (0.0, 0.0, 1.0)))
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, tcp[3:] / np.linalg.norm(tcp[3:]))
        drive = np.array((x, y, unwrap_yaw(float(np.arctan2(sine, cosine)), near_yaw), *robot[4 : 4 + joints]))
        head = np.asarray(observation.get("head", ()), float)
        return cls(
            drive,
            T_world_base,
            T_world_base @ pose_matrix(tcp[:3], rotation),
            float(gripper[0]),
            float(gripper[len(gripper) // 2]),
            head[: len(head) // 2],
        )

    @property
    def is_gripping(self) -> bool:
        """Whether the fingers press on something."""
        return self.width > self.commanded + _PRESSED


class BelievedSensor:
    """Snapshots for the executor: objects stay where they are believed to be; what is gripped moves with the TCP.

    Attributes:
        names: of the objects.
        held: the object in the gripper, None for none.
    """

    def __init__(self, bodies: Sequence[Body], reading: RobotReading, robot: RobotSpec, held: HeldObject | None = None):
        self._bodies = {body.name: body for body in bodies}
        self._robot, self._reading, self.held = robot, reading, held
        self.names = tuple(self._bodies)

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The objects where they are believed to be."""
        return tuple(self._bodies.values())

    def update(self, reading: RobotReading) -> None:
        """Take in a reading: fingers that close on an object grasp it, and let go of it when they open."""
        self._reading = reading
        if self.held is not None:
            body = self._bodies[self.held.name]
            self._bodies[body.name] = body.at_pose(reading.T_world_tcp @ self.held.T_tcp_object)
            if not reading.is_gripping:
                self.held = None
        elif reading.is_gripping and reading.commanded < self._robot.max_opening / 2:
            tcp = reading.T_world_tcp[:3, 3]
            inside = {
                body.name: float((np.abs(body.rotation.T @ (tcp - body.position)) - body.half_extents).max())
                for body in self._bodies.values()
            }
            nearest = min(inside, key=lambda name: inside[name], default="")
            if nearest and inside[nearest] < _AROUND:
                self.held = HeldObject.grasped(self._bodies[nearest], reading.T_world_tcp)

    def read(self) -> Snapshot:
        """The present belief."""
        bodies = self._bodies.values()
        return Snapshot(
            np.array([body.position for body in bodies]).reshape(-1, 3),
            np.array([body.rotation[2, 2] for body in bodies]),
            np.array([body.yaw for body in bodies]),
            self._reading.T_world_tcp,
            self._reading.drive,
        )
