"""One simulated world: the model, its data, the controller's memory, and what can be measured in it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from clutter_env.scene.layout import TABLE_HEIGHT, Layout
from clutter_env.scene.table_scene import TableScene, object_name
from clutter_env.simulation.apply_scene import apply_scene
from clutter_env.simulation.control import JointController
from clutter_env.simulation.model import ModelIndex, compile_model

__all__ = ["Measurements", "World"]

TOPPLED_ANGLE = math.radians(45.0)
"""[rad] An object has toppled if its axis leans farther from the vertical, a lying cylinder's from the horizontal."""
_UPRIGHT = 0.0, (1 - math.cos(TOPPLED_ANGLE)) / 2
_LYING = 0.5, math.sin(TOPPLED_ANGLE) / 2
"""qx² + qy² = (1 - cos tilt) / 2 of an object as it was placed, and its change beyond which the object has toppled."""
FALLEN_BELOW = TABLE_HEIGHT - 0.01
"""[m] An object whose centre is lower has left the table; 1 cm below the top, more than any contact gives way."""

_NO_OBJECT = -1
"""The slot of a geom that is no object."""


@dataclass(frozen=True)
class Measurements:
    """What observation, reward and success are computed from, after a control step.

    `poses` (n, 7) world poses of the objects, `is_fallen` (n,) toppled or off the table, `is_off` (n,) below the table
    top, `held` slot between both fingers or -1, `is_touching` whether a finger touches anything.
    """

    poses: NDArray[np.float64]
    is_fallen: NDArray[np.bool_]
    is_off: NDArray[np.bool_]
    held: int
    is_touching: bool


class World:
    """Physics of one robot, one table and a fixed number of objects; `reset` applies a scene to it."""

    def __init__(
        self,
        robot: RobotSpec,
        layout: Layout,
        shapes: tuple[str, ...],
        image_size: tuple[int, int] = (480, 480),
        show_meshes: bool = False,
    ) -> None:
        self.robot = robot
        self.shapes = shapes
        self.model = compile_model(robot, layout, shapes, image_size, show_meshes)
        self.data = mujoco.MjData(self.model)
        self.index = ModelIndex.of(self.model, robot, len(shapes))
        self.controller = JointController(self.model, self.index, robot)
        self.names = tuple(object_name(slot) for slot in range(len(shapes)))
        self._slot_of_geom = [_NO_OBJECT] * self.model.ngeom
        self._slot_of_geom[self.index.object_geoms] = range(len(shapes))
        self.scene: TableScene | None = None
        self._last: tuple[bytes, Measurements] | None = None

    @cached_property
    def spare_data(self) -> mujoco.MjData:
        """Further data of the model, in which a state can be kept while another one is tried."""
        return mujoco.MjData(self.model)

    def apply_scene(self, scene: TableScene) -> None:
        """Give the model's objects the sizes, masses and colours of `scene`; the data do not change."""
        self.scene, self._last = scene, None
        self._placed_tilt, self._toppled_change = np.where(scene.is_lying, np.array([_LYING]).T, np.array([_UPRIGHT]).T)
        apply_scene(self.model, self.index, scene)

    def reset(self, scene: TableScene, configuration: tuple[float, ...] | None = None) -> None:
        """Start afresh: objects at rest on the table, the robot at rest at the scene's base pose.

        Args:
            scene: what stands where.
            configuration: torso and arm joints (1 + n,), the robot's home configuration without it.
        """
        self.apply_scene(scene)
        model, data, index = self.model, self.data, self.index
        mujoco.mj_resetData(model, data)
        data.qpos[index.drive_qpos] = (*scene.base, *(self.robot.home if configuration is None else configuration))
        data.qpos[index.finger_qpos] = self.robot.max_finger_position
        data.qpos[index.still_qpos] = self.robot.still_configuration
        self.controller.reset(data)
        mujoco.mj_forward(model, data)

    def advance(self, measurements: Measurements, velocity: NDArray[np.float64], grip: float) -> Measurements:
        """One control step; see `JointController.follow`.

        The fingers are coupled while they touch something. Free fingers move alike without it, and a physics step
        without any constraint takes a fifth less time.

        Args:
            measurements: what was measured before the step.
            velocity: (4 + n,) wanted joint velocities, base x and y in the base's frame.
            grip: wanted finger position, -1 closed to 1 open.
        """
        self.data.eq_active[self.index.finger_couplings] = measurements.is_touching
        self.controller.follow(self.model, self.data, velocity, grip, is_loaded=measurements.held >= 0)
        self.settle_kinematics()
        return self.measure()

    def settle_kinematics(self) -> None:
        """Bring body and site poses up to date with the positions that the last physics step reached."""
        mujoco.mj_kinematics(self.model, self.data)

    def measure(self) -> Measurements:
        """The present state of the objects."""
        return self.measure_objects(*self._grip())

    def measure_objects(self, held: int, is_touching: bool) -> Measurements:
        """The present state of the objects, where it is known what the fingers hold and touch.

        It is the same object as the last time if nothing has changed, as in most steps while all objects sleep.
        """
        content = self.data.qpos[self.index.object_qpos].tobytes()
        if self._last is not None:
            before, last = self._last
            if content == before and held == last.held and is_touching == last.is_touching:
                return last
        poses = np.frombuffer(content).reshape(-1, 7)
        is_off = poses[:, 2] < FALLEN_BELOW
        tilt = poses[:, 4:6] ** 2
        is_fallen = is_off | (np.abs(tilt[:, 0] + tilt[:, 1] - self._placed_tilt) > self._toppled_change)
        if held >= 0:
            is_fallen[held] = False
        measurements = Measurements(poses, is_fallen, is_off, held, is_touching)
        self._last = content, measurements
        return measurements

    def lowest_point(self, measurements: Measurements, slot: int) -> float:
        """Height [m] of an object's lowest point above the floor."""
        assert self.scene is not None
        height, w, x, y, z = measurements.poses[slot, 2:].tolist()
        down_x, down_y, down_z = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        half_x, half_y, half_z = self.scene.half_extents[slot].tolist()
        if self.scene.is_box[slot]:
            side = half_x * abs(down_x) + half_y * abs(down_y)
        else:
            side = half_x * math.sqrt(max(1 - down_z * down_z, 0.0))
        return height - side - half_z * abs(down_z)

    def _grip(self) -> tuple[int, bool]:
        """The object that both fingers touch, -1 without one; and whether a finger touches anything."""
        if not self.data.ncon:
            return -1, False
        right_pad, left_pad = self.index.finger_geoms
        slot_of, right, left = self._slot_of_geom, set(), set()
        for one, other in self.data.contact.geom.tolist():
            if right_pad in (one, other):
                right.add(max(slot_of[one], slot_of[other]))
            if left_pad in (one, other):
                left.add(max(slot_of[one], slot_of[other]))
        both = [slot for slot in right & left if slot >= 0]
        return min(both, default=-1), bool(right or left)
