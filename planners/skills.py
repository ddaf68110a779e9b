"""Skills: clear one object from one direction, or take the target; and picks and placements that somebody else chose.

A skill is a choice among the grasps and placements that the strategies choose from. `simulate_kinematically` returns
the scene after a skill, if every motion to a free configuration exists and succeeds; `plan` plans its motions.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.clearing.commitments import grasped
from planners.collision.world import CompiledScenes
from planners.contact import Contact
from planners.context import PlanningContext
from planners.grasping.arm_configurations import (
    ConfigurationGrid,
    GripperPoses,
    scan_configurations,
)
from planners.grasping.candidates import GraspCandidate, as_candidates, gripper_poses
from planners.grasping.grasp_poses import GraspPose, generate_grasps, opening_around
from planners.motion.path import BlockedBy, NoPath
from planners.placing.locations import put_down
from planners.placing.placements import Placement
from planners.placing.surfaces import KeepClear
from planners.scene import Body, HeldObject, Scene
from planners.scene.cover import needs_drive
from planners.strategies import STRATEGIES
from planners.tamp.motion_layer import BoundMotion, MotionLayer
from planners.tamp.solution import BoundAction

Array = NDArray[np.float64]

DIRECTIONS = 6
"""Approach directions, evenly about the vertical (n of Fig. 6); each stands for the yaws within half a step of it."""
_CLEARANCE_REGION = STRATEGIES["dogar"]
"""A cleared object keeps clear of the target's grasp (eq. 1), the farthest location first."""
_EDGE = 1e-6
"""[rad] Yaws on the border of two directions belong to both."""
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


@dataclass(frozen=True)
class Skill:
    """Clear `object` by grasping it from `direction` (0 to `DIRECTIONS` - 1), or, with None, take it as the target."""

    object: str
    direction: int | None = None


@dataclass(frozen=True)
class SkillFailure:
    """Why a skill could not be done: "blocked", "unreachable", "no place", "motion", or a deviation."""

    reason: str


@dataclass(frozen=True)
class SkillPlanner:
    """Grasps, placements and motions of skills.

    Attributes:
        context: the robot among the static obstacles.
        compiled: scenes compiled so far.
    """

    context: PlanningContext
    compiled: CompiledScenes = field(default_factory=CompiledScenes)

    @classmethod
    def of(cls, scene: Scene) -> SkillPlanner:
        """For the scene's robot among the scene's static obstacles, for every arrangement of its objects."""
        return cls(PlanningContext.of(scene.robot, scene, grasps="side"))

    def grasps(self, scene: Scene, skill: Skill) -> tuple[GraspCandidate, ...] | SkillFailure:
        """Free grasps for the skill, best first."""
        found = self.options(scene, skill)
        free = [option for option in found if option.blockers == 0]
        if not free:
            return SkillFailure("blocked" if found else "unreachable")
        return tuple(sorted(free, key=lambda option: -option.quality))

    def in_the_way(self, scene: Scene, skill: Skill) -> tuple[str, ...]:
        """Names of the objects in the way of the least obstructed grasp; none if there is no grasp at all."""
        options = self.options(scene, skill)
        if not options:
            return ()
        return scene.names_of(min(options, key=lambda each: (each.blockers.bit_count(), -each.quality)).blockers)

    def options(self, scene: Scene, skill: Skill) -> list[GraspCandidate]:
        """Grasps for the skill with what is in the way of each."""
        body, step = scene.body(skill.object), 2 * np.pi / DIRECTIONS
        grasps = generate_grasps(body, scene.robot)
        if skill.direction is not None:
            away = [(grasp.yaw - skill.direction * step + np.pi) % (2 * np.pi) - np.pi for grasp in grasps]
            grasps = tuple(grasp for grasp, turn in zip(grasps, away, strict=True) if abs(turn) <= step / 2 + _EDGE)
        return self.candidates(scene, body, grasps)

    def candidates(self, scene: Scene, body: Body, grasps: Sequence[GraspPose]) -> list[GraspCandidate]:
        """Grasps of an object at some gripper poses, with what is in the way of each."""
        if not grasps:
            return []
        world = self.compiled.world(scene)
        wanted = gripper_poses(grasps)
        opening = max(grasp.opening for grasp in grasps)
        placer = self.context.arms[scene.robot.arm_name]
        bases, index = placer.bases(wanted)
        ignore = scene.mask({body.name})
        poses = GripperPoses(bases, wanted[index])
        found = scan_configurations(world, poses, ConfigurationGrid.over(placer.chain), opening, ignore=ignore)
        return as_candidates(body.name, poses, opening, found, scene.robot.arm_name)

    def placements(self, scene: Scene, target: str, rng: np.random.Generator) -> Iterator[Placement]:
        """Placements for the held object that keep clear of the target's least obstructed grasp, best first."""
        assert scene.held is not None
        keep_clear = KeepClear()
        if scene.held.name != target and target in scene.names:
            # The held object is on its way out, so it obstructs no grasp.
            held = scene.mask({scene.held.name})
            options = self.options(scene, Skill(target))
            keep_clear = KeepClear(
                min(options, key=lambda each: ((each.blockers & ~held).bit_count(), -each.quality), default=None)
            )
        return self.context.placements().find(self.compiled.world(scene), keep_clear, _CLEARANCE_REGION, rng)

    def simulate_kinematically(
        self, scene: Scene, target: str, skill: Skill, rng: np.random.Generator
    ) -> Scene | SkillFailure:
        """The scene after the skill if every motion succeeds; after taking the target, it is held."""
        grasps = self.grasps(scene, skill)
        if isinstance(grasps, SkillFailure):
            return grasps
        in_hand = grasped(scene, grasps[0])
        if skill.direction is None:
            return in_hand
        place = next(self.placements(in_hand, target, rng), None)
        if place is None:
            return SkillFailure("no place")
        state = replace(in_hand.state, base=place.base)
        return in_hand.with_held(None).with_body(place.body).with_state(state)

    def plan(
        self, scene: Scene, target: str, skill: Skill, rng: np.random.Generator
    ) -> tuple[BoundAction, ...] | SkillFailure:
        """The motions of a skill, as actions of the domain without symbols; a held object is put down first.

        What is put down keeps clear of the target's grasp. Raises `UnknownObject`.
        """
        motion_layer = MotionLayer(self.context, rng, self.compiled)
        done: tuple[BoundAction, ...] = ()
        if scene.held is not None:
            emptied = self._put_aside(motion_layer, scene, target)
            if emptied is None:
                return SkillFailure("no place")
            done, scene = emptied
        grasps = self.grasps(scene, skill)
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

    def plan_through(
        self, scene: Scene, target: str, skill: Skill, rng: np.random.Generator
    ) -> tuple[BoundAction, ...] | SkillFailure:
        """The plan by the least obstructed grasp, as if what is in its way were not there; raises `UnknownObject`."""
        in_the_way = self.in_the_way(scene, skill)
        others = tuple(body for body in scene.objects if body.name not in in_the_way)
        return self.plan(replace(scene, objects=others), target, skill, rng)

    def _put_aside(self, motion_layer: MotionLayer, scene: Scene, target: str) -> _Planned | None:
        """Put the held object where it keeps clear of the target's grasp; None if there is no such place."""
        assert scene.held is not None
        for placement in itertools.islice(self.placements(scene, target, motion_layer.rng), _PLACEMENTS):
            placed = _place(motion_layer, scene, scene.held.name, placement)
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
    held = scene.held or HeldObject.grasped(body, contact.tcp)
    opening = opening_around(scene.robot, body, held)
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
            covered, arm = needs_drive(scene, body.foot), scene.robot.arm_name
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

    The gripper is at (5,) x, y, z [m], yaw and pitch [rad], the body where it is picked, or where it will stand.
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
