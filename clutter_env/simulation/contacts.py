"""The contacts of a physics step: what the robot touches, and which forces are its own doing."""

from __future__ import annotations

import math
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.simulation.model import ModelIndex

_ROBOT, _FURNITURE, _OBJECT = 1, 4, 16
"""Kinds of geoms; 0 of the ground. Two of them in contact have a sum that no other two have."""
_GRAVITY = 9.81
"""[m/s²]"""


class Contacts(NamedTuple):
    """The contacts of one physics step, sorted; numbers are indices into MuJoCo's list of contacts.

    Attributes:
        pairs: the two geoms of each contact.
        of_robot: contacts of the robot with furniture, but for those of its fingers with handles.
        of_moved: contacts with furniture of the objects that the robot moves, and their weight [N]: group by group of
            those that touch each other, one of which it touches.
        of_self: contacts of the robot with itself and the ground.
        between_parts: contacts of each part of the robot with such a group, group by group of those that several parts
            touch. A gripper is one part, any other body of the robot is one.
        moved: slots of the objects that the robot moves.
        touched: slots of those that it touches itself.
        gripped: slots of those that each gripper touches.
        presses_furniture, presses_itself: whether there are contacts with a force on furniture; on the robot or ground.
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
    """Sorts the contacts of a model's physics steps; most have those of the step before, which it remembers.

    Attributes:
        slot_of: slot of the object that each geom belongs to, -1 of what is no object.
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
        """Forget the last contacts: the objects have got other masses."""
        self._key, self._last = b"", NO_CONTACTS

    def read(self, data: mujoco.MjData) -> Contacts:
        """The contacts that the last physics step had."""
        return self.read_some(data) if data.ncon else NO_CONTACTS

    def read_some(self, data: mujoco.MjData) -> Contacts:
        """The contacts that the last physics step had, if there were any."""
        geoms = data.contact.geom
        if (key := geoms.tobytes()) != self._key:
            self._key, self._last = key, self._sort(geoms.tolist())
        return self._last

    def is_robot(self, geom: int) -> bool:
        """Whether a geom is a part of the robot."""
        return self._kinds[geom] == _ROBOT

    def furniture_force(self, data: mujoco.MjData, contacts: Contacts) -> float:
        """[N] with which the robot presses on furniture: itself, and beyond their weight the objects that it moves.

        Their weight presses downwards alone, each group's for itself: pushed against a wall, they press with all of the
        force, and so do they where something else lies on the robot.
        """
        force = self._normal_force(data, contacts.of_robot)
        for numbers, weight in contacts.of_moved:
            pressed, downwards = self._forces_on_furniture(data, contacts, numbers)
            force += pressed - min(max(downwards, 0.0), weight)
        return force

    def self_force(self, data: mujoco.MjData, contacts: Contacts) -> float:
        """[N] with which the robot presses on itself and on the ground.

        Parts that touch one object, or several that touch each other, press on each other by what cancels of the forces
        that they have on these. The forces of a gripper's fingers count together: its own grip is none.
        """
        force = self._normal_force(data, contacts.of_self)
        for parts in contacts.between_parts:
            nets = [self._net_force(data, contacts, numbers) for numbers in parts]
            whole = [sum(axis) for axis in zip(*nets, strict=True)]
            force += (sum(math.hypot(*net) for net in nets) - math.hypot(*whole)) / 2
        return force

    def _normal_force(self, data: mujoco.MjData, numbers: list[int]) -> float:
        """[N] Sum of the normal forces of some contacts."""
        if not numbers:
            return 0.0
        if len(numbers) == 1:  # of more, an array of all forces is read faster
            mujoco.mj_contactForce(self._model, data, numbers[0], self._force)
            return self._force.item(0)
        # With elliptic cones it is the first number that the solver has of each contact.
        total, forces, rows = 0.0, data.efc_force, data.contact.efc_address
        for number in numbers:
            row = rows.item(number)
            if row >= 0:  # -1 where the solver has none
                total += forces.item(row)
        return total

    def _net_force(self, data: mujoco.MjData, contacts: Contacts, numbers: list[int]) -> list[float]:
        """[N] Sum of the forces (3,) of some contacts on objects, with friction."""
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
        """[N] Sum of the normal forces of objects on furniture, and of their parts downwards."""
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
        """Contacts of the robot with objects, part by part of the robot."""
        parts = dict[int, list[int]]()
        for number in numbers:
            one, other = pairs[number]
            parts.setdefault(self._parts[one if self._kinds[one] == _ROBOT else other], []).append(number)
        return list(parts.values())

    def _weight(self, group: frozenset[int]) -> float:
        """[N] of some objects."""
        return sum(float(self._model.body_mass[self._bodies.start + slot]) for slot in sorted(group)) * _GRAVITY

    def _groups(self, touched: frozenset[int], neighbours: list[list[int]]) -> list[frozenset[int]]:
        """Slots of the objects that are touched, each with those that touch it, however indirectly."""
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
    """The geoms of the fingers of all grippers: of the bodies of their pads."""
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
