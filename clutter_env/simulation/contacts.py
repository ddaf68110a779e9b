"""Contacts of a physics step: what the robot touches, and the forces that it causes."""

from __future__ import annotations

import math
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.simulation.model import ModelIndex

_ROBOT, _FURNITURE, _OBJECT = 1, 4, 16
"""Kinds of geoms. The ground is 0. The sum identifies the pair of kinds in contact."""
_GRAVITY = 9.81
"""[m/s²]"""


class Contacts(NamedTuple):
    """The contacts of one physics step, sorted. Numbers are indices into MuJoCo's list of contacts.

    Attributes:
        pairs: the two geoms of each contact.
        of_robot: contacts of the robot with furniture, except those of its fingers with handles.
        of_moved: contacts with furniture of the objects that the robot moves, and the objects' weight [N], for each
            group. A group is a set of objects in contact with each other, of which the robot touches at least one.
        of_self: contacts of the robot with itself and the ground.
        between_parts: contacts of each part of the robot with such a group, for each group that several parts touch. A
            gripper is one part, and so is any other body of the robot.
        moved: slots of the objects that the robot moves.
        touched: slots of the objects that the robot itself touches.
        gripped: slots of the objects that each gripper touches.
        presses_furniture, presses_itself: whether any contact has a force on furniture, or on the robot or the ground.
    """

    pairs: list[list[int]]
    of_robot: list[int]
    of_moved: list[tuple[list[int], float]]
    of_self: list[int]
    between_parts: list[list[list[int]]]
    moved: frozenset[int]
    touched: frozenset[int]
    gripped: tuple[frozenset[int], ...]
    presses_furniture: bool
    presses_itself: bool


NO_CONTACTS = Contacts([], [], [], [], [], frozenset(), frozenset(), (), False, False)


class ContactReader:
    """Sorts the contacts of a model's physics steps. It remembers the last step, because the contacts of most steps are
    the same.

    Attributes:
        slot_of: slot of the object that each geom belongs to, -1 for other geoms.
        grippers: the geoms of both fingers, and of the body that carries them, of each gripper.
    """

    def __init__(self, model: mujoco.MjModel, index: ModelIndex) -> None:
        self._model, self._bodies = model, index.object_bodies
        self.slot_of = [-1] * model.ngeom
        self.slot_of[index.object_geoms] = index.geom_slots.tolist()
        self.grippers = [_gripper_geoms(model, pads) for pads in index.finger_geoms]
        self._kinds, self._force = _kinds_of_geoms(model, index), np.empty(6)
        self._handles = frozenset(index.handles.tolist())
        self._fingers = _finger_geoms(model, index)
        self._parts: list[int] = model.body_weldid[model.geom_bodyid].tolist()
        for number, gripper in enumerate(self.grippers):
            for geom in gripper:
                self._parts[geom] = -1 - number
        self._nothing_gripped = (frozenset[int](),) * len(self.grippers)
        self.forget()

    def forget(self) -> None:
        """Forget the last contacts, because the masses of the objects have changed."""
        self._key, self._last = b"", NO_CONTACTS

    def read(self, data: mujoco.MjData) -> Contacts:
        """Contacts of the last physics step."""
        return self.read_some(data) if data.ncon else NO_CONTACTS

    def read_some(self, data: mujoco.MjData) -> Contacts:
        """Contacts of the last physics step, which has at least one."""
        geoms = data.contact.geom
        if (key := geoms.tobytes()) != self._key:
            self._key, self._last = key, self._sort(geoms.tolist())
        return self._last

    def is_robot(self, geom: int) -> bool:
        """Whether a geom is a part of the robot."""
        return self._kinds[geom] == _ROBOT

    def furniture_force(self, data: mujoco.MjData, contacts: Contacts) -> float:
        """Force [N] of the robot on furniture: its own, and that of the objects that it moves beyond their weight.

        The weight is subtracted from the downward force alone, separately for each group. Objects pushed against a wall
        press with the whole force, as do objects while something else lies on the robot.
        """
        force = self._normal_force(data, contacts.of_robot)
        for numbers, weight in contacts.of_moved:
            pressed, downwards = self._forces_on_furniture(data, contacts, numbers)
            force += pressed - min(max(downwards, 0.0), weight)
        return force

    def self_force(self, data: mujoco.MjData, contacts: Contacts) -> float:
        """Force [N] of the robot on itself and on the ground.

        Several parts of the robot may touch one object, or objects in contact with each other. The parts then press on
        each other by the share of their forces that cancels. The forces of a gripper's fingers are added first, so its
        own grip is not included.
        """
        force = self._normal_force(data, contacts.of_self)
        for parts in contacts.between_parts:
            nets = [self._net_force(data, contacts, numbers) for numbers in parts]
            whole = [sum(axis) for axis in zip(*nets, strict=True)]
            force += (sum(math.hypot(*net) for net in nets) - math.hypot(*whole)) / 2
        return force

    def _normal_force(self, data: mujoco.MjData, numbers: list[int]) -> float:
        """Sum [N] of the normal forces of some contacts."""
        if not numbers:
            return 0.0
        if len(numbers) == 1:  # for more contacts, reading the array of all forces is faster
            mujoco.mj_contactForce(self._model, data, numbers[0], self._force)
            return self._force.item(0)
        # With elliptic cones the first constraint row of each contact is its normal force.
        total, forces, rows = 0.0, data.efc_force, data.contact.efc_address
        for number in numbers:
            row = rows.item(number)
            if row >= 0:  # -1 if the solver has no row for the contact
                total += forces.item(row)
        return total

    def _net_force(self, data: mujoco.MjData, contacts: Contacts, numbers: list[int]) -> list[float]:
        """Sum [N] of the forces (3,) of some contacts on objects, with friction."""
        net, force = [0.0] * 3, self._force
        for number in numbers:
            mujoco.mj_contactForce(self._model, data, number, force)
            sign = 1.0 if self._kinds[contacts.pairs[number][1]] == _OBJECT else -1.0
            frame = data.contact.frame[number].tolist()
            for row, size in enumerate(force[:3].tolist()):
                for axis in range(3):
                    net[axis] += sign * size * frame[3 * row + axis]
        return net

    def _forces_on_furniture(self, data: mujoco.MjData, contacts: Contacts, numbers: list[int]) -> tuple[float, float]:
        """Sums [N] of the normal forces of objects on furniture, and of their downward components."""
        total = downwards = 0.0
        frame, force = data.contact.frame, self._force
        for number in numbers:
            mujoco.mj_contactForce(self._model, data, number, force)
            size, normal = force.item(0), frame.item(number, 2)  # towards the second geom
            is_on_second = self._kinds[contacts.pairs[number][1]] == _FURNITURE
            total += size
            downwards += size * (-normal if is_on_second else normal)
        return total, downwards

    def _sort(self, pairs: list[list[int]]) -> Contacts:
        kind_of = self._kinds
        kinds = [kind_of[one] + kind_of[other] for one, other in pairs]  # faster than arrays of so few contacts
        of_robot = [k for k, kind in enumerate(kinds) if kind == _ROBOT + _FURNITURE]
        if self._handles and of_robot:  # where furniture is to be grasped
            of_robot = [k for k in of_robot if not self._is_on_handle(pairs[k])]
        of_self = [k for k, kind in enumerate(kinds) if kind in (2 * _ROBOT, _ROBOT)]
        if _ROBOT + _OBJECT not in kinds:
            none, pressed = frozenset[int](), (bool(of_robot), bool(of_self))
            return Contacts(pairs, of_robot, [], of_self, [], none, none, self._nothing_gripped, *pressed)
        slots = [max(self.slot_of[one], self.slot_of[other]) for one, other in pairs]
        by_robot = [k for k, kind in enumerate(kinds) if kind == _ROBOT + _OBJECT]
        touched = frozenset(slots[k] for k in by_robot)
        groups = self._groups(touched, [pair for pair, kind in zip(pairs, kinds, strict=True) if kind == 2 * _OBJECT])
        on_furniture = [k for k, kind in enumerate(kinds) if kind == _OBJECT + _FURNITURE]
        borne = [([k for k in on_furniture if slots[k] in group], self._weight(group)) for group in groups]
        of_moved = [(numbers, weight) for numbers, weight in borne if numbers]
        gripped = tuple(
            frozenset(slots[k] for k in by_robot if not gripper.isdisjoint(pairs[k])) for gripper in self.grippers
        )
        by_part = [self._by_part(pairs, [k for k in by_robot if slots[k] in group]) for group in groups]
        between_parts = [parts for parts in by_part if len(parts) > 1]
        return Contacts(
            pairs,
            of_robot,
            of_moved=of_moved,
            of_self=of_self,
            between_parts=between_parts,
            moved=frozenset().union(*groups),
            touched=touched,
            gripped=gripped,
            presses_furniture=bool(of_robot or of_moved),
            presses_itself=bool(of_self or between_parts),
        )

    def _is_on_handle(self, pair: list[int]) -> bool:
        """Whether a contact is that of a finger with a handle."""
        one, other = pair
        return (one in self._handles and other in self._fingers) or (other in self._handles and one in self._fingers)

    def _by_part(self, pairs: list[list[int]], numbers: list[int]) -> list[list[int]]:
        """Contacts of the robot with objects, grouped by part of the robot."""
        parts = dict[int, list[int]]()
        for number in numbers:
            one, other = pairs[number]
            parts.setdefault(self._parts[one if self._kinds[one] == _ROBOT else other], []).append(number)
        return list(parts.values())

    def _weight(self, group: frozenset[int]) -> float:
        """Weight [N] of some objects."""
        return sum(float(self._model.body_mass[self._bodies.start + slot]) for slot in sorted(group)) * _GRAVITY

    def _groups(self, touched: frozenset[int], neighbours: list[list[int]]) -> list[frozenset[int]]:
        """Groups of slots: the touched objects, each with the objects in direct or indirect contact with it."""
        pairs = [{self.slot_of[one], self.slot_of[other]} for one, other in neighbours]
        groups = list[frozenset[int]]()
        for slot in sorted(touched):
            if not any(slot in group for group in groups):
                group = frozenset({slot})
                while grown := {other for pair in pairs if not group.isdisjoint(pair) for other in pair} - group:
                    group |= grown
                groups.append(group)
        return groups


def _gripper_geoms(model: mujoco.MjModel, pads: tuple[int, int]) -> frozenset[int]:
    """The geoms of both fingers and of the body that carries them."""
    fingers = model.geom_bodyid[list(pads)]
    bodies = {*fingers.tolist(), *model.body_parentid[fingers].tolist()}
    return frozenset(np.flatnonzero(np.isin(model.geom_bodyid, list(bodies))).tolist())


def _finger_geoms(model: mujoco.MjModel, index: ModelIndex) -> frozenset[int]:
    """Geoms of the fingers of all grippers, which are those of the bodies with their pads."""
    bodies = {int(model.geom_bodyid[pad]) for pads in index.finger_geoms for pad in pads}
    return frozenset(np.flatnonzero(np.isin(model.geom_bodyid, list(bodies))).tolist())


def _kinds_of_geoms(model: mujoco.MjModel, index: ModelIndex) -> list[int]:
    """The kind of each geom."""
    kinds: NDArray[np.int8] = np.zeros(model.ngeom, np.int8)
    is_static = model.body_weldid[model.geom_bodyid] == 0
    is_static |= np.isin(model.geom_bodyid, model.jnt_bodyid[np.isin(model.jnt_qposadr, index.opening_qpos)])
    kinds[is_static & (model.geom_type != int(mujoco.mjtGeom.mjGEOM_PLANE))] = _FURNITURE
    kinds[model.body_rootid[model.geom_bodyid] == model.body_rootid[index.base_body]] = _ROBOT
    kinds[index.object_geoms] = _OBJECT
    return kinds.tolist()
