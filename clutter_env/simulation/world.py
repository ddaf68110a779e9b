"""One simulated world: the model, its data, the controller's memory, and measurements.

A reset writes sizes, masses, inertias, colours and start poses into the model. Every such entry is written every time,
so that the episode depends on this scene alone and not on earlier scenes.
"""

from __future__ import annotations

import colorsys
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import ActingJoints, RobotSpec
from clutter_env.config import PHYSICS_STEPS
from clutter_env.scene.household import KINDS, HouseholdScene
from clutter_env.scene.layout import TABLE_HEIGHT, Layout, lowest_support, openings_of
from clutter_env.scene.opening import Opening
from clutter_env.scene.table_scene import TableScene, object_name
from clutter_env.simulation.contacts import ContactReader, Contacts
from clutter_env.simulation.control import SEGMENTS, JointController
from clutter_env.simulation.model import ModelIndex, compile_model
from clutter_env.simulation.pressing import Pressing

TOPPLED_ANGLE = math.radians(45.0)
"""[rad] An object has toppled if its axis leans farther from the vertical. For a lying cylinder: from the
horizontal."""
_UPRIGHT = 0.0, (1 - math.cos(TOPPLED_ANGLE)) / 2
_LYING = 0.5, math.sin(TOPPLED_ANGLE) / 2
"""qx² + qy² = (1 - cos tilt) / 2 of an object as placed, and the change of this value beyond which it has toppled."""
LEAST_GRIP = 0.5
"""Least share of a held object's weight that the fingers can carry. An object in the air slips at once if its fingers
cannot carry its whole weight. The share is below 1 because the object shakes while it moves."""
_OPPOSITE = -math.sqrt(0.5)
"""Largest cosine of the angle between the fingers' forces on a held object: 45° from opposite."""
_LATERAL = math.sqrt(0.5)
"""Largest vertical part of the normal of a contact that carries nothing: 45° from the horizontal. Objects that an
object only brushes neither bear it nor lie on it."""
_GRAVITY = 9.81
"""[m/s²]"""
_PART_STEPS = PHYSICS_STEPS // SEGMENTS
"""Physics steps for each command of the motors."""
_AWAKE = -(1 + int(mujoco.mjMINAWAKE))
"""Entry of `tree_asleep` for a body that has just moved."""
_FALLEN_BELOW = 0.01
"""[m] An object whose centre is this far below the lowest support has left the supports. No contact yields so much."""

SUNK = 1e-6
"""[m] Depth below a drawer's floor face at which objects in it start. Without a contact an object would sleep on while
the drawer slides away under it."""

_TARGET_COLOUR = (0.87, 0.12, 0.10, 1.0)
_HUES = (0.14, 0.92)
"""Hues of the objects that are not the target: neither red nor the colours of wood."""
_GOLDEN_RATIO = 0.6180339887


@dataclass(frozen=True)
class Grip:
    """State of the grippers, with that of the active arm first.

    Attributes:
        held: slot of the object that both fingers press from opposite sides and can carry, -1 for none.
        is_carried: whether in the whole control step only the gripper has borne the object, with nothing lying on it.
        is_touching: whether any finger touches anything.
    """

    held: tuple[int, ...]
    is_carried: tuple[bool, ...]
    is_touching: bool

    @property
    def is_holding(self) -> bool:
        """Whether any gripper holds an object."""
        return max(self.held) >= 0

    @property
    def carried(self) -> list[int]:
        """Slots of the carried objects."""
        return [slot for slot, is_carried in zip(self.held, self.is_carried, strict=True) if is_carried]


@dataclass(frozen=True)
class Measurements:
    """Measured quantities after a control step. Observation, reward and success are computed from them.

    Attributes:
        poses: (n, 7) world poses of the objects.
        is_fallen: (n,) whether each has toppled without being held, or is off the table without being carried.
        is_off: (n,) whether each is below the lowest support: the table top, unless the layout has a lower one.
        grip: what the grippers hold and touch.
        moved: slots of the objects that the robot has touched in any part of the control step, itself or through other
            objects.
    """

    poses: NDArray[np.float64]
    is_fallen: NDArray[np.bool_]
    is_off: NDArray[np.bool_]
    grip: Grip
    moved: frozenset[int] = frozenset()

    @property
    def held(self) -> int:
        """Slot in the gripper of the active arm, -1 for none."""
        return self.grip.held[0]


class Mark(NamedTuple):
    """A coloured rectangle in pictures that marks a place for an object. It has no contacts.

    Attributes:
        centre: (3,) [m] in the world.
        half_extents: (2,) [m] along its own axes.
        yaw: [rad]
        rgba: (4,)
    """

    centre: NDArray[np.float64]
    half_extents: NDArray[np.float64]
    yaw: float
    rgba: NDArray[np.float64]


class World:
    """Physics of one robot, one table and a fixed number of objects. `reset` applies a scene to it.

    Attributes:
        openings: the furniture's drawers, from left to right, or its door. () if it has neither.
        on_furniture: forces of the robot and the objects that it moves on furniture since the reset.
        on_itself: forces of the robot on itself and on the ground.
    """

    scene: TableScene
    """That of the episode; there is none before the first."""

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
        self.openings = openings_of(layout)
        self._drawers = tuple(one for one in self.openings if one.is_slide)
        self._fallen_below = lowest_support(layout) - _FALLEN_BELOW
        self.model = compile_model(robot, layout, shapes, image_size, show_meshes)
        self.data = mujoco.MjData(self.model)
        self.index = ModelIndex.of(self.model, robot, len(shapes))
        self.controller = JointController(self.model, self.index, robot)
        self.names = tuple(object_name(slot) for slot in range(len(shapes)))
        self._reader = ContactReader(self.model, self.index)
        self._colours = self.model.geom_rgba[self.index.object_geoms].copy()  # of household objects
        self._grip_command = _full_grip(self.model, self.index) if KINDS.keys() & set(shapes) else 0.0
        self._pads = {pad for pads in self.index.finger_geoms for pad in pads}
        grippers = len(self.index.finger_geoms)
        self._empty_grip = Grip((-1,) * grippers, (False,) * grippers, False)
        self._robot_tree = int(self.model.body_treeid[self.index.base_body])
        self._warnings = self.data.warning.number
        self._home = self.model.qpos0.copy()
        self._home[self.index.drive_qpos[3:]] = ActingJoints.of(robot).home
        self._home[self.index.finger_qpos[:2]] = robot.max_finger_position
        self._home[self.index.still_qpos] = robot.still_configuration
        self._home = self._home[: self.index.object_qpos.start]
        self.on_furniture, self.on_itself = Pressing(), Pressing()
        self._contacts: list[Contacts] = []  # after each part of the last control step
        self._supports: list[set[tuple[int, int]]] = []  # likewise: see `_supported`
        self.marks: tuple[Mark, ...] = ()
        self._last: tuple[bytes, Measurements] | None = None

    @cached_property
    def spare_data(self) -> mujoco.MjData:
        """Further data of the model, to keep a state while another state is tried."""
        return mujoco.MjData(self.model)

    def apply_scene(self, scene: TableScene) -> None:
        """Write the sizes, masses, colours and start poses of `scene` into the model. The data do not change."""
        self.scene, self.marks, self._last = scene, (), None
        self._reader.forget()
        self._placed_tilt, self._toppled_change = np.where(scene.is_lying, np.array([_LYING]).T, np.array([_UPRIGHT]).T)
        model, index = self.model, self.index
        if self.openings:
            model.dof_frictionloss[index.opening_dof], model.dof_damping[index.opening_dof] = scene.joints.T
        if not scene.num_objects:
            return
        if isinstance(scene, HouseholdScene):  # the model already has the sizes and masses of each kind
            model.geom_rgba[index.object_geoms] = self._colours
        else:
            _apply_shapes(model, index, scene)
            _apply_masses(model, index, scene)
            model.geom_rgba[index.object_geoms] = _palette(scene.num_objects)
        if scene.target >= 0:
            model.geom_rgba[index.object_geoms][index.geom_slots == scene.target] = _TARGET_COLOUR
        poses = start_poses(scene)
        for drawer in self._drawers:
            poses[_are_inside(drawer, poses, 0.0), 2] -= SUNK
        model.qpos0[index.object_qpos] = poses.ravel()

    def colour(self, slot: int) -> NDArray[np.float64]:
        """Colour (4,) in pictures of the object in a slot. It may be written until the next scene."""
        first = int(self.index.geom_slots.searchsorted(slot))
        return np.asarray(self.model.geom_rgba[self.index.object_geoms.start + first])

    def reset(self, scene: TableScene) -> None:
        """Start an episode: objects at rest on the table, the robot at rest at the scene's base pose, at home."""
        self.apply_scene(scene)
        model, data, index = self.model, self.data, self.index
        mujoco.mj_resetData(model, data)
        data.qpos[: index.object_qpos.start] = self._home
        data.qpos[index.drive_qpos[:3]] = scene.base
        self.controller.reset(data)
        self.on_furniture, self.on_itself = Pressing(), Pressing()
        self._contacts, self._supports = [], []
        mujoco.mj_forward(model, data)

    @property
    def opening(self) -> Opening | None:
        """First drawer or door, None if the layout has neither."""
        return self.openings[0] if self.openings else None

    @property
    def opened(self) -> float:
        """Opening of the first drawer or door as a share of its travel: 0 closed, 1 open. 0 if the layout has
        neither."""
        return self.opened_shares[0] if self.openings else 0.0

    @property
    def opened_shares(self) -> list[float]:
        """Opening of each drawer or door as a share of its travel: 0 closed, 1 open."""
        positions = self.data.qpos[self.index.opening_qpos].tolist()
        return [position / one.travel for position, one in zip(positions, self.openings, strict=True)]

    def opened_around(self, measurements: Measurements, slot: int) -> float:
        """Opening of the drawer or door that encloses an object. 1 if none of several drawers contains it."""
        if len(self.openings) <= 1:
            return self.opened
        inside = [self.are_in_drawer(measurements, number)[slot] for number in range(len(self._drawers))]
        return next((share for share, is_in in zip(self.opened_shares, inside, strict=True) if is_in), 1.0)

    @property
    def drawer_shifts(self) -> list[float]:
        """Displacement [m] of each drawer along x, 0 or negative."""
        if not self._drawers:
            return []
        positions = self.data.qpos[self.index.opening_qpos].tolist()
        return [float(one.axis[0] * position) for position, one in zip(positions, self._drawers, strict=True)]

    def are_in_drawer(self, measurements: Measurements, number: int = 0) -> NDArray[np.bool_]:
        """Whether the centre of each object is now inside a drawer: (n,)."""
        if number >= len(self._drawers):
            return np.zeros(len(measurements.poses), np.bool_)
        return _are_inside(self._drawers[number], measurements.poses, self.drawer_shifts[number])

    @property
    def is_unstable(self) -> bool:
        """Whether MuJoCo has warned since the reset. The simulation has then diverged, or its memory was too small."""
        return any(self._warnings.tolist())

    def advance(
        self,
        measurements: Measurements,
        velocity: NDArray[np.float64],
        grips: Sequence[float],
        head: Sequence[float] = (),
    ) -> Measurements:
        """Advance by one control step, see `JointController`.

        The fingers are coupled while they touch something. Free fingers move alike without the coupling, and a physics
        step without constraints takes a fifth less time.

        Args:
            measurements: what was measured before the step.
            velocity: (4 + n,) desired joint velocities, base x and y in the base's frame.
            grips: wanted finger position of each gripper, -1 closed to 1 open.
            head: rates of the head's joints, -1 to 1. () if the head stays still.
        """
        model, data, grip = self.model, self.data, measurements.grip
        for coupling in self.index.finger_couplings:
            data.eq_active[coupling] = grip.is_touching
        self._contacts, self._supports, ctrl = [], [], data.ctrl
        reader, first, mj_step = self._reader, 0, mujoco.mj_step
        on_furniture, on_itself = [0.0] * PHYSICS_STEPS, [0.0] * PHYSICS_STEPS  # [N]
        for command in self.controller.advance(data, velocity, grips, grip.is_holding, head):
            ctrl[:] = command
            if self._grip_command:  # thin walls are held with all the force of the fingers
                for actuator in self.index.finger_actuators:
                    ctrl[actuator] = ctrl[actuator] or self._grip_command
            for step in range(first, first + _PART_STEPS):
                mj_step(model, data)
                if data.ncon:
                    contacts = reader.read_some(data)
                    if contacts.presses_furniture:
                        on_furniture[step] = reader.furniture_force(data, contacts)
                    if contacts.presses_itself:
                        on_itself[step] = reader.self_force(data, contacts)
            if data.ncon:
                self._note(contacts)
            first += _PART_STEPS
        self.on_furniture.add(on_furniture)
        self.on_itself.add(on_itself)
        # A physics step leaves body and site poses at the positions from which it started.
        mujoco.mj_kinematics(model, data)
        moved = frozenset().union(*(contacts.moved for contacts in self._contacts))
        return self.measure_objects(self._measure_grip(self._reader.read(data)), moved)

    def _note(self, contacts: Contacts) -> None:
        """Record the contacts of a part of the control step, and keep objects awake that the robot touches.

        An object at rest in the gripper or on the arm is about to sleep, with all objects on it. Asleep, it would stay
        in the air when the robot releases it.
        """
        self._contacts.append(contacts)
        if not contacts.touched:
            return
        self._supports.append(self._supported(contacts))
        islands, asleep = self.data.tree_island.tolist(), self.data.tree_asleep
        island = islands[self._robot_tree]
        for tree, (its_island, state) in enumerate(zip(islands, asleep.tolist(), strict=True)):
            if its_island == island and state < 0:
                asleep[tree] = _AWAKE

    @property
    def touched(self) -> set[int]:
        """Slots of the objects that the robot has touched in any part of the last control step."""
        return {slot for contacts in self._contacts for slot in contacts.touched}

    def measure(self) -> Measurements:
        """Measure the present state of the objects."""
        return self.measure_objects(self._measure_grip(self._reader.read(self.data)))

    def measure_objects(self, grip: Grip, moved: frozenset[int] = frozenset()) -> Measurements:
        """Measure the present state of the objects, given the grip and the objects that the robot has touched.

        Return the last measurements themselves if nothing has changed, as in most steps while all objects sleep.
        """
        content = self.data.qpos[self.index.object_qpos].tobytes()
        if self._last is not None:
            before, last = self._last
            if content == before and grip == last.grip and moved == last.moved:
                return last
        poses = np.frombuffer(content).reshape(-1, 7)
        is_off = poses[:, 2] < self._fallen_below
        tilt = poses[:, 4:6] ** 2
        is_fallen = is_off | (np.abs(tilt[:, 0] + tilt[:, 1] - self._placed_tilt) > self._toppled_change)
        for slot, is_carried in zip(grip.held, grip.is_carried, strict=True):
            if is_carried or (slot >= 0 and not is_off[slot]):
                is_fallen[slot] = False
        measurements = Measurements(poses, is_fallen, is_off, grip, moved)
        self._last = content, measurements
        return measurements

    def lowest_point(self, measurements: Measurements, slot: int) -> float:
        """Height [m] of an object's lowest point above the ground."""
        height, w, x, y, z = measurements.poses[slot, 2:].tolist()
        down_x, down_y, down_z = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        if isinstance(self.scene, HouseholdScene):
            points, radii = KINDS[self.shapes[slot]].cloud
            return height + float((points @ (down_x, down_y, down_z) - radii).min())
        half_x, half_y, half_z = self.scene.half_extents[slot].tolist()
        if self.scene.is_box[slot]:
            side = half_x * abs(down_x) + half_y * abs(down_y)
        else:
            side = half_x * math.sqrt(max(1 - down_z * down_z, 0.0))
        return height - side - half_z * abs(down_z)

    def _measure_grip(self, contacts: Contacts) -> Grip:
        """Find what the grippers hold and touch, from the contacts of the last physics step.

        The other parts of the control step decide whether a held object is carried. An object that vibrates in the grip
        touches the table in some of them.
        """
        pairs, pads = contacts.pairs, self._pads
        at_pads = [pair for pair in pairs if pair[0] in pads or pair[1] in pads]
        if not at_pads:
            return self._empty_grip
        slot_of, held, is_carried = self._reader.slot_of, [], []
        for number, pads_of in enumerate(self.index.finger_geoms):
            right, left = (
                {max(slot_of[one], slot_of[other]) for one, other in at_pads if pad in (one, other)} for pad in pads_of
            )
            slot = next(
                (slot for slot in sorted(right & left) if slot >= 0 and self._is_gripped(slot, pads_of, pairs)), -1
            )
            held.append(slot)
            is_carried.append(slot >= 0 and all((number, slot) not in supported for supported in self._supports))
        return Grip(tuple(held), tuple(is_carried), is_touching=True)

    def _is_gripped(self, slot: int, pads: tuple[int, int], pairs: list[list[int]]) -> bool:
        """Whether two pads press on an object from opposite sides, and can carry it.

        Each contact carries by the vertical component of its normal force, and by friction across its normal.
        """
        slot_of, contact, sizes = self._reader.slot_of, self.data.contact, self.data.efc_force
        frames, rows, frictions = contact.frame, contact.efc_address.tolist(), contact.friction
        pressed, can_carry = [[0.0] * 3, [0.0] * 3], 0.0
        for number, ((one, other), row) in enumerate(zip(pairs, rows, strict=True)):
            is_second = slot_of[other] == slot
            pad = one if is_second else other
            if (is_second or slot_of[one] == slot) and pad in pads and row >= 0:  # -1 where the solver has none
                force, on = sizes[row].item() * (1.0 if is_second else -1.0), pressed[pads.index(pad)]
                normal = frames[number, :3].tolist()  # towards the second geom
                for axis, share in enumerate(normal):
                    on[axis] += share * force
                level = math.sqrt(max(1.0 - normal[2] ** 2, 0.0))
                can_carry += normal[2] * force + abs(force) * level * float(frictions[number, 0])
        right, left = (math.hypot(*force) for force in pressed)
        along = sum(one * other for one, other in zip(*pressed, strict=True))
        weight = float(self.model.body_mass[self.index.object_bodies.start + slot]) * _GRAVITY
        return right * left > 0.0 and along <= _OPPOSITE * right * left and can_carry >= LEAST_GRIP * weight

    def _supported(self, contacts: Contacts) -> set[tuple[int, int]]:
        """Grippers and slots of objects at their pads that another body supports, or on which another body lies.

        Any contact with the rest of the robot, or with a second gripper, is regarded as such a contact.
        """
        slot_of, found = self._reader.slot_of, set[tuple[int, int]]()
        if not any(contacts.gripped):
            return found
        normals = np.abs(self.data.contact.frame[:, 2]).tolist()
        for number, (gripper, slots) in enumerate(zip(self._reader.grippers, contacts.gripped, strict=True)):
            for (one, other), normal in zip(contacts.pairs, normals, strict=True):
                for slot, geom in ((slot_of[one], other), (slot_of[other], one)):
                    if slot in slots and geom not in gripper and (normal > _LATERAL or self._reader.is_robot(geom)):
                        found.add((number, slot))
        return found


def _full_grip(model: mujoco.MjModel, index: ModelIndex) -> float:
    """Command [m] of closed fingers that press with their full force on objects of any width. The model is changed so
    that the command is valid."""
    fingers = index.finger_actuators
    command = float((model.actuator_forcerange[fingers, 1] / model.actuator_biasprm[fingers, 1]).min())
    model.actuator_ctrlrange[fingers, 0] = command
    return command


def _apply_shapes(model: mujoco.MjModel, index: ModelIndex, scene: TableScene) -> None:
    """Write sizes, bounding boxes and bounding spheres. The angular length of a free body is the radius of its
    sphere."""
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
    """Write masses, principal moments of homogeneous cylinders and boxes, and the constants that follow from them.

    An object is a free body whose frame is its principal frame, so the results of `mj_setConst` are known in closed
    form. That function would take a quarter of a reset's time, because it also computes the robot's constants again.
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


def _are_inside(drawer: Opening, poses: NDArray[np.float64], shift: float) -> NDArray[np.bool_]:
    """Whether the centre of each object is inside a drawer with a displacement [m] along x: (n,)."""
    low, high = np.array(drawer.inside) + (shift, 0.0, 0.0)
    return np.asarray(((low < poses[:, :3]) & (poses[:, :3] < high)).all(axis=1))


def start_poses(scene: TableScene) -> NDArray[np.float64]:
    """Free-joint positions (n, 7) of objects that exactly touch table or shelf. A lying cylinder's z axis is
    horizontal."""
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

    Hues step by the golden ratio, so that neighbours in number differ most. Lightness has a period of three.
    """
    colours = np.ones((count, 4))
    for slot in range(count):
        hue = _HUES[0] + (_HUES[1] - _HUES[0]) * ((slot * _GOLDEN_RATIO) % 1.0)
        colours[slot, :3] = colorsys.hls_to_rgb(hue, (0.50, 0.66, 0.38)[slot % 3], 0.65)
    return colours
