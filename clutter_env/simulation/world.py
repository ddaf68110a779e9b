"""One simulated world: the model, its data, the controller's memory, and what can be measured in it.

A reset writes sizes, masses, inertias, colours and start poses into the model. Every such entry is written every time,
so that the episode depends on this scene alone and not on earlier ones.
"""

from __future__ import annotations

import colorsys
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import ActingJoints, RobotSpec
from clutter_env.scene.layout import TABLE_HEIGHT, Layout
from clutter_env.scene.table_scene import TableScene, object_name
from clutter_env.simulation.control import JointController
from clutter_env.simulation.model import ModelIndex, compile_model

TOPPLED_ANGLE = math.radians(45.0)
"""[rad] An object has toppled if its axis leans farther from the vertical, a lying cylinder's from the horizontal."""
_UPRIGHT = 0.0, (1 - math.cos(TOPPLED_ANGLE)) / 2
_LYING = 0.5, math.sin(TOPPLED_ANGLE) / 2
"""qx² + qy² = (1 - cos tilt) / 2 of an object as it was placed, and its change beyond which the object has toppled."""
FALLEN_BELOW = TABLE_HEIGHT - 0.01
"""[m] An object whose centre is lower has left the table; 1 cm below the top, more than any contact gives way."""

_TARGET_COLOUR = (0.87, 0.12, 0.10, 1.0)
_HUES = (0.14, 0.92)
"""Hues of the objects that are not the target: neither red nor the colours of wood."""
_GOLDEN_RATIO = 0.6180339887


@dataclass(frozen=True)
class Measurements:
    """Measured quantities after a control step, from which observation, reward and success follow.

    `poses` (n, 7) world poses of the objects, `is_fallen` (n,) toppled or off the table, `is_off` (n,) below the table
    top, `all_held` for each gripper, that of the active arm first, the slot between both fingers or -1, `is_touching`
    whether a finger touches anything.
    """

    poses: NDArray[np.float64]
    is_fallen: NDArray[np.bool_]
    is_off: NDArray[np.bool_]
    all_held: tuple[int, ...]
    is_touching: bool

    @property
    def held(self) -> int:
        """The slot in the gripper of the active arm, -1 for none."""
        return self.all_held[0]

    @property
    def is_holding(self) -> bool:
        """Whether some gripper holds something."""
        return any(slot >= 0 for slot in self.all_held)


class World:
    """Physics of one robot, one table and a fixed number of objects; `reset` applies a scene to it."""

    def __init__(
        self,
        robot: RobotSpec,
        layout: Layout,
        shapes: tuple[str, ...],
        image_size: tuple[int, int],
        show_meshes: bool,
    ) -> None:
        self.robot = robot
        self.shapes = shapes
        self.model = compile_model(robot, layout, shapes, image_size, show_meshes)
        self.data = mujoco.MjData(self.model)
        self.index = ModelIndex.of(self.model, robot, len(shapes))
        self.controller = JointController(self.model, self.index, robot)
        self.names = tuple(object_name(slot) for slot in range(len(shapes)))
        self._slot_of_geom = [-1] * self.model.ngeom  # of what is no object
        self._slot_of_geom[self.index.object_geoms] = range(len(shapes))
        self.scene: TableScene | None = None
        self._last: tuple[bytes, Measurements] | None = None

    @cached_property
    def spare_data(self) -> mujoco.MjData:
        """Further data of the model, in which a state can be kept while another one is tried."""
        return mujoco.MjData(self.model)

    def apply_scene(self, scene: TableScene) -> None:
        """Give the model's objects the sizes, masses, colours and start poses of `scene`; the data do not change."""
        self.scene, self._last = scene, None
        self._placed_tilt, self._toppled_change = np.where(scene.is_lying, np.array([_LYING]).T, np.array([_UPRIGHT]).T)
        model, index = self.model, self.index
        if not scene.num_objects:
            return
        _apply_shapes(model, index, scene)
        _apply_masses(model, index, scene)
        model.geom_rgba[index.object_geoms] = _palette(scene.num_objects)
        model.geom_rgba[index.object_geoms.start + scene.target] = _TARGET_COLOUR
        model.qpos0[index.object_qpos] = _start_poses(scene).ravel()

    def reset(self, scene: TableScene) -> None:
        """Start afresh: objects at rest on the table, the robot at rest at the scene's base pose, at home."""
        self.apply_scene(scene)
        model, data, index = self.model, self.data, self.index
        mujoco.mj_resetData(model, data)
        data.qpos[index.drive_qpos] = (*scene.base, *ActingJoints.of(self.robot).home)
        data.qpos[index.finger_qpos[:2]] = self.robot.max_finger_position
        data.qpos[index.still_qpos] = self.robot.still_configuration
        self.controller.reset(data)
        mujoco.mj_forward(model, data)

    def advance(
        self, measurements: Measurements, velocity: NDArray[np.float64], grips: Sequence[float]
    ) -> Measurements:
        """One control step; see `JointController.follow`.

        The fingers are coupled while they touch something. Free fingers move alike without it, and a physics step
        without any constraint takes a fifth less time.

        Args:
            measurements: what was measured before the step.
            velocity: (4 + n,) wanted joint velocities, base x and y in the base's frame.
            grips: wanted finger position of each gripper, -1 closed to 1 open.
        """
        self.data.eq_active[self.index.finger_couplings] = measurements.is_touching
        self.controller.follow(self.model, self.data, velocity, grips, is_loaded=measurements.is_holding)
        # A physics step leaves body and site poses at the positions from which it started.
        mujoco.mj_kinematics(self.model, self.data)
        return self.measure()

    def measure(self) -> Measurements:
        """The present state of the objects."""
        return self.measure_objects(*self._grip())

    def measure_objects(self, all_held: tuple[int, ...], is_touching: bool) -> Measurements:
        """The present state of the objects, where it is known what the fingers hold and touch.

        It is the same object as the last time if nothing has changed, as in most steps while all objects sleep.
        """
        content = self.data.qpos[self.index.object_qpos].tobytes()
        if self._last is not None:
            before, last = self._last
            if content == before and all_held == last.all_held and is_touching == last.is_touching:
                return last
        poses = np.frombuffer(content).reshape(-1, 7)
        is_off = poses[:, 2] < FALLEN_BELOW
        tilt = poses[:, 4:6] ** 2
        is_fallen = is_off | (np.abs(tilt[:, 0] + tilt[:, 1] - self._placed_tilt) > self._toppled_change)
        for slot in all_held:
            if slot >= 0:
                is_fallen[slot] = False
        measurements = Measurements(poses, is_fallen, is_off, all_held, is_touching)
        self._last = content, measurements
        return measurements

    def lowest_point(self, measurements: Measurements, slot: int) -> float:
        """Height [m] of an object's lowest point above the ground."""
        assert self.scene is not None
        height, w, x, y, z = measurements.poses[slot, 2:].tolist()
        down_x, down_y, down_z = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        half_x, half_y, half_z = self.scene.half_extents[slot].tolist()
        if self.scene.is_box[slot]:
            side = half_x * abs(down_x) + half_y * abs(down_y)
        else:
            side = half_x * math.sqrt(max(1 - down_z * down_z, 0.0))
        return height - side - half_z * abs(down_z)

    def _grip(self) -> tuple[tuple[int, ...], bool]:
        """The object that both fingers of each gripper touch, -1 for none; whether a finger touches anything."""
        grippers = self.index.finger_geoms
        if not self.data.ncon:
            return (-1,) * len(grippers), False
        contacts, slot_of = self.data.contact.geom.tolist(), self._slot_of_geom
        touched = [
            [{max(slot_of[one], slot_of[other]) for one, other in contacts if pad in (one, other)} for pad in pads]
            for pads in grippers
        ]
        all_held = tuple(min((slot for slot in right & left if slot >= 0), default=-1) for right, left in touched)
        return all_held, any(right or left for right, left in touched)


def _apply_shapes(model: mujoco.MjModel, index: ModelIndex, scene: TableScene) -> None:
    """Sizes, bounding boxes and bounding spheres; a free body turns by angles as long as its sphere's radius."""
    half, geoms = scene.half_extents, index.object_geoms
    cylinder_size = half[:, (0, 2, 2)] * (1.0, 1.0, 0.0)
    model.geom_size[geoms] = np.where(scene.is_box[:, None], half, cylinder_size)
    model.geom_aabb[geoms, 3:] = half
    model.bvh_aabb[index.object_bvh, 3:] = half
    x2, y2, z2 = (half**2).T
    radii = np.sqrt(np.where(scene.is_box, x2 + y2, x2) + z2)
    model.geom_rbound[geoms] = radii
    model.dof_length[index.object_dof].reshape(-1, 6)[:, 3:] = radii[:, None]


def _apply_masses(model: mujoco.MjModel, index: ModelIndex, scene: TableScene) -> None:
    """Masses, principal moments of homogeneous cylinders and boxes, and the constants that follow from them.

    An object is a free body whose frame is its principal frame: what `mj_setConst` derives is known in closed form.
    That function would take a quarter of a reset's time, because it also derives the robot's constants again.
    """
    bodies, dof, masses = index.object_bodies, index.object_dof, scene.masses
    x2, y2, z2 = (scene.half_extents**2).T
    box = np.column_stack((y2 + z2, x2 + z2, x2 + y2)) / 3
    side = x2 / 4 + z2 / 3
    cylinder = np.column_stack((side, side, x2 / 2))
    inertias = masses[:, None] * np.where(scene.is_box[:, None], box, cylinder)
    model.body_mass[bodies] = model.body_subtreemass[bodies] = masses
    model.body_subtreemass[0] = model.body_mass.sum()
    model.body_inertia[bodies] = inertias
    diagonal = model.dof_M0[dof].reshape(-1, 2, 3)
    diagonal[:, 0], diagonal[:, 1] = masses[:, None], inertias
    inverse = 1 / diagonal
    mean = (inverse[..., 0] + inverse[..., 1] + inverse[..., 2]) / 3
    model.body_invweight0[bodies] = mean
    model.dof_invweight0[dof].reshape(-1, 2, 3)[:] = mean[..., None]


def _start_poses(scene: TableScene) -> NDArray[np.float64]:
    """Free-joint positions (n, 7): exactly touching table or shelf; a lying cylinder's z axis is horizontal."""
    poses = np.zeros((scene.num_objects, 7))
    poses[:, :2] = scene.positions
    poses[:, 2] = TABLE_HEIGHT + scene.levels + scene.standing_extents[:, 2]
    poses[:, 3], poses[:, 6] = cosine, sine = np.cos(scene.yaws / 2), np.sin(scene.yaws / 2)
    if scene.is_lying.any():
        tipped = math.sqrt(0.5) * np.column_stack((cosine, -sine, cosine, sine))
        poses[scene.is_lying, 3:] = tipped[scene.is_lying]
    return poses


@cache
def _palette(count: int) -> NDArray[np.float64]:
    """Colours (count, 4) of objects that are not the target.

    Hues step by the golden ratio, so that neighbours in number differ most; lightness has a period of three.
    """
    colours = np.ones((count, 4))
    for slot in range(count):
        hue = _HUES[0] + (_HUES[1] - _HUES[0]) * ((slot * _GOLDEN_RATIO) % 1.0)
        colours[slot, :3] = colorsys.hls_to_rgb(hue, (0.50, 0.66, 0.38)[slot % 3], 0.65)
    return colours
