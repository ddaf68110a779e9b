"""Sensing of the robot without a view of the world: its joints, its gripper, and the believed poses of objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.expert.monitor import Snapshot
from planners.motion.base import unwrap_yaw
from planners.scene import Body, HeldObject, Scene
from planners.scene.bodies import pose_matrix
from planners.scene.moving import moved

Array = NDArray[np.float64]

_PRESSED = 0.004
"""Least difference [m] between commanded and actual opening of fingers that press on something."""
_OF_JOINT = 6
"""Numbers of an observation for each joint: position, velocity, share, and handle position."""
_SHIFTED = 1e-4
"""Least motion [m], [rad] of a drawer or door. Smaller ones are noise."""
_AROUND = 0.03
"""Distance [m] of the TCP outside an object that the fingers may have closed on."""


@dataclass(frozen=True, eq=False)
class RobotReading:
    """Robot state at one control step.

    `drive` (4 + n,) base x, y [m], yaw [rad], torso, arm. T_world_base, T_world_tcp (4, 4). `width` and `commanded`
    [m]: distances of the finger pads. `head` (2,) pan and tilt [rad], or (0,) for a fixed head. `joints` (k,) [m] or
    [rad] of drawers and doors, in the order of `Scene.openings`.
    """

    drive: Array
    T_world_base: Array
    T_world_tcp: Array
    width: float
    commanded: float
    head: Array
    joints: Array = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(cls, observation: Mapping[str, Any], near_yaw: float = 0.0) -> RobotReading:
        """Robot state from the entries `robot`, `tcp`, `gripper`, `head` and `joints` of an observation.

        `joints` has six numbers for each joint, the first is its position. The yaw is within half a turn of `near_yaw`.
        """
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
            np.asarray(observation.get("joints", ()), float).reshape(-1, _OF_JOINT)[:, 0],
        )

    @property
    def is_gripping(self) -> bool:
        """Whether the fingers press on something."""
        return self.width > self.commanded + _PRESSED


def opened_as_read(scene: Scene, reading: RobotReading) -> Scene:
    """Scene with drawers and doors, and their contents, at the measured positions. Unchanged if nothing moved."""
    for one, position in zip(scene.openings, reading.joints.tolist(), strict=False):
        if abs(position - one.position) > _SHIFTED:
            scene = moved(scene, one.name, position)
    return scene


class BelievedSensor:
    """Sensor for the executor, from believed poses. Gripped objects and contents of drawers move along.

    Attributes:
        names: names of the objects.
        held: the object in the gripper, if any.
        brought: names of the objects that were moved in the gripper.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        reading: RobotReading,
        robot: RobotSpec,
        held: HeldObject | None = None,
        workplace: Scene | None = None,
    ) -> None:
        """Begin with objects at their poses, and with furniture, without objects, that may open."""
        self._bodies = {body.name: body for body in bodies}
        self._robot, self._reading, self.held, self._workplace = robot, reading, held, workplace
        self.names, self.brought = tuple(self._bodies), set[str]()

    @property
    def bodies(self) -> tuple[Body, ...]:
        """Objects at their believed poses."""
        return tuple(self._bodies.values())

    def update(self, reading: RobotReading) -> None:
        """Update with a robot state: fingers that close on an object grasp it, and release it when they open."""
        self._reading = reading
        self._ride()
        if self.held is not None:
            body = self._bodies[self.held.name]
            self.brought.add(body.name)
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

    def _ride(self) -> None:
        """Move the contents of a drawer that has moved."""
        if self._workplace is None or not len(self._reading.joints):
            return
        before = replace(self._workplace, objects=self.bodies, held=self.held)
        if (after := opened_as_read(before, self._reading)) is not before:
            self._bodies = {body.name: body for body in after.objects}
            there = after.static_obstacles, after.openings
            self._workplace = replace(self._workplace, static_obstacles=there[0], openings=there[1])

    def read(self) -> Snapshot:
        """Snapshot of the present belief."""
        openings = () if self._workplace is None else self._workplace.openings
        there = zip((one.name for one in openings), self._reading.joints.tolist(), strict=False)
        bodies = self._bodies.values()
        return Snapshot(
            np.array([body.position for body in bodies]).reshape(-1, 3),
            np.array([body.rotation[2, 2] for body in bodies]),
            np.array([body.quaternion for body in bodies]).reshape(-1, 4),
            self._reading.T_world_tcp,
            self._reading.drive,
            dict(there),
        )
