"""The planned motion to one contact that somebody else has chosen."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from planners.contact import Contact
from planners.grasping.arm_configurations import (
    ArmConfigurations,
    ConfigurationGrid,
    GripperPoses,
    scan_configurations,
)
from planners.grasping.candidates import GraspCandidate
from planners.grasping.driven_configurations import driven_configurations
from planners.grasping.grasp_poses import gripper_opening
from planners.motion.arm import BlockedBy, NoPath
from planners.placing.placements import Placement
from planners.placing.release import put_down
from planners.scene import Body, Scene
from planners.scene.cover import is_covered
from planners.tamp.motion_layer import BoundMotion, MotionLayer
from planners.tamp.solution import BoundAction

__all__ = ["plan_contact"]

Array = NDArray[np.float64]

_TORSOS, _ROLLS = 6, 18
"""Torso heights and upper-arm rolls tried where those about the home configuration do not fit."""
_CONFIGURATIONS = 4
"""Arm configurations tried for one contact."""


def plan_contact(
    motion_layer: MotionLayer, scene: Scene, contact: Contact
) -> tuple[BoundAction, BoundAction] | BlockedBy | NoPath:
    """The drive to a contact, and the pick or placement there; the arm configuration is chosen here.

    Args:
        motion_layer: plans the motions.
        scene: where to start; of a placement, with the object held.
        contact: where the base stands, and where the gripper closes or opens.

    Returns:
        the two actions, or why there is no motion.

    Raises:
        UnknownObject: no such object.
        ValueError: the object of a placement is not held.
    """
    if contact.skill == "place" and contact.object not in scene.held_names:
        raise ValueError(f"{contact.object} is not held, so it cannot be put down")
    reason: BlockedBy | NoPath = NoPath("no arm configuration reaches the contact")
    for q, hits in islice(_configurations(motion_layer, scene, contact), _CONFIGURATIONS):
        if hits:
            reason = BlockedBy(frozenset(scene.names_of(hits)), "grasp")
            continue
        found = _motion(motion_layer, scene, contact, q)
        if isinstance(found, tuple):
            return found
        reason = found
    return reason


def _configurations(motion_layer: MotionLayer, scene: Scene, contact: Contact) -> Iterator[tuple[Array, int]]:
    """Arm configurations at the contact and masks of what they hit; first those about the home configuration."""
    chain = motion_layer.candidates.chain
    grids = (
        ConfigurationGrid.about_home(chain, scene.robot.home),
        ConfigurationGrid.over(chain, _TORSOS, _ROLLS),
    )
    for grid in grids:
        found = _scan(motion_layer, scene, contact, grid)
        order = sorted(range(len(found.q)), key=lambda i: (int(found.hits[i]).bit_count(), -found.quality[i]))
        yield from ((found.q[i], int(found.hits[i])) for i in order)


def _scan(motion_layer: MotionLayer, scene: Scene, contact: Contact, grid: ConfigurationGrid) -> ArmConfigurations:
    world, body = motion_layer.candidates.compiled.world(scene), _standing(scene, contact)
    poses = GripperPoses(np.array(contact.base)[None], _gripper_pose(contact)[None])
    ignore = scene.mask({contact.object})
    if is_covered(scene, body.foot):
        return driven_configurations(world, body, poses, grid, _opening(scene, contact), held=scene.held, ignore=ignore)
    return scan_configurations(world, poses, grid, _opening(scene, contact), held=scene.held, ignore=ignore)


def _motion(
    motion_layer: MotionLayer, scene: Scene, contact: Contact, q: Array
) -> tuple[BoundAction, BoundAction] | BlockedBy | NoPath:
    """The two actions in one arm configuration."""
    yaw, pitch = map(float, _gripper_pose(contact)[3:])
    body, opening = _standing(scene, contact), _opening(scene, contact)
    base = np.array(contact.base)
    if contact.skill == "place":
        placement = Placement(body, base, q, yaw, pitch, opening)
        driven = motion_layer.drive_to_placement(scene, placement)
        name = "PutDownGeneral"
        bound = driven if isinstance(driven, NoPath) else motion_layer.put_down(driven.scene, placement)
    else:
        covered, arm = is_covered(scene, body.foot), scene.robot.arm_name
        grasp = GraspCandidate(contact.object, base, q, yaw, pitch, opening, 0, 0.0, covered, arm)
        driven = motion_layer.drive_to_grasp(scene, grasp)
        name = "PickUp"
        bound = driven if isinstance(driven, NoPath) else motion_layer.pick_up(driven.scene, grasp)
    if isinstance(driven, NoPath) or not isinstance(bound, BoundMotion):
        assert not isinstance(bound, BoundMotion)
        return bound
    return _action("MoveBase", contact, scene, driven), _action(name, contact, driven.scene, bound)


def _action(name: str, contact: Contact, scene: Scene, motion: BoundMotion) -> BoundAction:
    """An action without symbols, and the scene in which its motion was planned."""
    return BoundAction(name, (contact.object,), motion.trajectory, scene, contact.object)


def _standing(scene: Scene, contact: Contact) -> Body:
    """The object where it is picked, or where it will stand."""
    if contact.skill == "pick":
        return scene.body(contact.object)
    level = max(
        (support.top for support in map(scene.support_named, scene.supports) if support.is_under(contact.tcp[:2, 3])),
        default=scene.support.top,
    )
    return put_down(scene, _gripper_pose(contact), level)


def _gripper_pose(contact: Contact) -> Array:
    """(5,) x, y, z [m], yaw and pitch [rad] of the TCP."""
    x_axis = contact.tcp[:3, 0]
    pitch = math.atan2(-float(x_axis[2]), math.hypot(float(x_axis[0]), float(x_axis[1])))
    return np.array([*contact.tcp[:3, 3], contact.yaw, pitch])


def _opening(scene: Scene, contact: Contact) -> float:
    """[m] of the open gripper around the object."""
    return gripper_opening(scene.robot, scene.body(contact.object).half_width)
