"""Motions of a pick or a placement that somebody else has chosen: by a skill, or by the pose of base and gripper."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.contact import Contact
from planners.grasping.arm_configurations import ConfigurationGrid, GripperPoses, scan_configurations
from planners.grasping.candidates import GraspCandidate
from planners.grasping.grasp_poses import gripper_opening
from planners.motion.path import BlockedBy, NoPath
from planners.placing.locations import put_down
from planners.placing.placements import Placement
from planners.scene import Body, Scene
from planners.scene.cover import is_covered
from planners.skills.geometry import Skill, SkillFailure, SkillGeometry
from planners.tamp.motion_layer import BoundMotion, MotionLayer
from planners.tamp.solution import BoundAction

Array = NDArray[np.float64]

_GRASPS = 3
"""Grasps tried before a skill counts as failed."""
_PLACEMENTS = 8
"""Placements tried for each of them."""
_CONFIGURATIONS = 4
"""Arm configurations tried for one pick or placement."""


class _Planned(NamedTuple):
    """The drive and what is done there, and the scene after it."""

    actions: tuple[BoundAction, BoundAction]
    scene: Scene


@dataclass
class SkillPlanner:
    """Binds skills to motions.

    Attributes:
        geometry: where grasps and placements come from.
        rng: for sampling.
    """

    geometry: SkillGeometry
    rng: np.random.Generator

    def plan(self, scene: Scene, target: str, skill: Skill) -> tuple[BoundAction, ...] | SkillFailure:
        """The motions of a skill, as actions of the domain without symbols; a held object is put down first.

        Args:
            scene: where to start.
            target: the object whose grasp must stay free.
            skill: what to do.

        Raises:
            UnknownObject: no object of that name.
        """
        geometry = self.geometry
        motion_layer = MotionLayer(geometry.context, self.rng, geometry.compiled)
        done: tuple[BoundAction, ...] = ()
        if scene.held is not None:
            emptied = self._put_aside(motion_layer, scene, target)
            if emptied is None:
                return SkillFailure("no place")
            done, scene = emptied
        grasps = geometry.grasps(scene, skill)
        if isinstance(grasps, SkillFailure):
            return grasps
        failure = SkillFailure("motion")
        for grasp in grasps[:_GRASPS]:
            picked = _pick(motion_layer, scene, grasp)
            if not isinstance(picked, _Planned):
                continue
            if skill.direction is None:
                return (*done, *picked.actions)
            placed = self._put_aside(motion_layer, picked.scene, target)
            if placed is not None:
                return (*done, *picked.actions, *placed.actions)
            failure = SkillFailure("no place")
        return failure

    def plan_through(self, scene: Scene, target: str, skill: Skill) -> tuple[BoundAction, ...] | SkillFailure:
        """The plan by the least obstructed grasp, as if what is in its way were not there.

        Raises:
            UnknownObject: no object of that name.
        """
        in_the_way = self.geometry.in_the_way(scene, skill)
        others = tuple(body for body in scene.objects if body.name not in in_the_way)
        return self.plan(replace(scene, objects=others), target, skill)

    def _put_aside(self, motion_layer: MotionLayer, scene: Scene, target: str) -> _Planned | None:
        """Put the held object where it keeps clear of the target's grasp; None if there is no such place."""
        assert scene.held is not None
        name = scene.held.name
        for placement in itertools.islice(self.geometry.placements(scene, target, self.rng), _PLACEMENTS):
            placed = _place(motion_layer, scene, name, placement)
            if isinstance(placed, _Planned):
                return placed
        return None


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
    x_axis = contact.tcp[:3, 0]
    pitch = math.atan2(-float(x_axis[2]), math.hypot(float(x_axis[0]), float(x_axis[1])))
    gripper = np.array([*contact.tcp[:3, 3], contact.yaw, pitch])
    if contact.skill == "pick":
        body = scene.body(contact.object)
    else:
        supports = map(scene.support_named, scene.supports)
        under = (support.top for support in supports if support.is_under(contact.tcp[:2, 3]))
        body = put_down(scene, gripper, max(under, default=scene.support.top))
    opening = gripper_opening(scene.robot, scene.body(contact.object).half_width)
    reason: BlockedBy | NoPath = NoPath("no arm configuration reaches the contact")
    configurations = _configurations(motion_layer, scene, contact, gripper, body, opening)
    for q, hits in itertools.islice(configurations, _CONFIGURATIONS):
        if hits:
            reason = BlockedBy(frozenset(scene.names_of(hits)), "grasp")
            continue
        base, yaw = np.array(contact.base), float(gripper[3])
        if contact.skill == "place":
            found = _place(motion_layer, scene, contact.object, Placement(body, base, q, yaw, pitch, opening))
        else:
            covered, arm = is_covered(scene, body.foot), scene.robot.arm_name
            grasp = GraspCandidate(contact.object, base, q, yaw, pitch, opening, 0, 0.0, covered, arm)
            found = _pick(motion_layer, scene, grasp)
        if isinstance(found, _Planned):
            return found.actions
        reason = found
    return reason


def _configurations(
    motion_layer: MotionLayer, scene: Scene, contact: Contact, gripper: Array, body: Body, opening: float
) -> Iterator[tuple[Array, int]]:
    """Arm configurations at a contact and masks of what they hit; first those about the home configuration.

    Args:
        motion_layer, scene, contact: as for `plan_contact`.
        gripper: (5,) x, y, z [m], yaw and pitch [rad] of the TCP.
        body: the object where it is picked, or where it will stand.
        opening: [m] of the open gripper around the object.
    """
    world, chain = motion_layer.compiled.world(scene), motion_layer.context.arms[scene.robot.arm_name].chain
    poses, ignore = GripperPoses(np.array(contact.base)[None], gripper[None]), scene.mask({contact.object})
    for grid in (ConfigurationGrid.about_home(chain, scene.robot.home), ConfigurationGrid.over(chain)):
        found = scan_configurations(world, poses, grid, opening, body=body, held=scene.held, ignore=ignore)
        order = sorted(range(len(found.q)), key=lambda i: (int(found.hits[i]).bit_count(), -found.quality[i]))
        yield from ((found.q[i], int(found.hits[i])) for i in order)


def _pick(motion_layer: MotionLayer, scene: Scene, grasp: GraspCandidate) -> _Planned | BlockedBy | NoPath:
    driven = motion_layer.drive_to_grasp(scene, grasp)
    if isinstance(driven, NoPath):
        return driven
    picked = motion_layer.pick_up(driven.scene, grasp)
    return _planned("PickUp", grasp.object, scene, driven, picked) if isinstance(picked, BoundMotion) else picked


def _place(motion_layer: MotionLayer, scene: Scene, name: str, placement: Placement) -> _Planned | BlockedBy | NoPath:
    driven = motion_layer.drive_to_placement(scene, placement)
    if isinstance(driven, NoPath):
        return driven
    placed = motion_layer.put_down(driven.scene, placement)
    return _planned("PutDownGeneral", name, scene, driven, placed) if isinstance(placed, BoundMotion) else placed


def _planned(name: str, target: str, scene: Scene, drive: BoundMotion, motion: BoundMotion) -> _Planned:
    """The two actions, without symbols, each with the scene in which its motion was planned."""
    driven = BoundAction("MoveBase", (target,), drive.trajectory, scene, target)
    return _Planned((driven, BoundAction(name, (target,), motion.trajectory, drive.scene, target)), motion.scene)
