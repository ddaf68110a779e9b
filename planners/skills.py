"""Skills: clear one object from one direction, or take the target.

A skill is a choice among the grasps and placements of the strategies. `simulate_kinematically` returns the scene after
a skill, on the assumption that all motions succeed. `plan` plans its motions.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.clearing.commitments import grasped
from planners.collision.world import CompiledScenes
from planners.grasping.arm_configurations import (
    ConfigurationGrid,
    GripperPoses,
    scan_configurations,
)
from planners.grasping.candidates import GraspCandidate, as_candidates, gripper_poses
from planners.grasping.grasp_poses import GraspPose, generate_grasps
from planners.motion.path import BlockedBy, NoPath
from planners.placing.placements import Placement
from planners.placing.surfaces import KeepClear
from planners.scene import Body, Scene
from planners.strategies import STRATEGIES
from planners.tamp.motion_layer import BoundMotion, MotionLayer
from planners.tamp.solution import BoundAction
from planners.workspace import Workspace

Array = NDArray[np.float64]

DIRECTIONS = 6
"""Approach directions, evenly about the vertical (n of Fig. 6). Each stands for the yaws within half a step."""
_CLEARANCE_REGION = STRATEGIES["dogar"]
"""Strategy for cleared objects: keep clear of the target's grasp (eq. 1), farthest location first."""
_EDGE = 1e-6
"""Tolerance [rad]: a yaw on the border of two directions belongs to both."""
_GRASPS = 3
"""Grasps to try before a skill fails."""
_PLACEMENTS = 8
"""Placements to try for each grasp."""


class _Planned(NamedTuple):
    """A drive and the action after it, with the resulting scene."""

    actions: tuple[BoundAction, BoundAction]
    scene: Scene


@dataclass(frozen=True)
class Skill:
    """A skill: clear `object` with a grasp from `direction` (0 to `DIRECTIONS` - 1), or, with None, take the target."""

    object: str
    direction: int | None = None


@dataclass(frozen=True)
class SkillFailure:
    """Reason why a skill failed: "blocked", "unreachable", "no place", "motion", or a deviation."""

    reason: str


@dataclass(frozen=True)
class SkillPlanner:
    """Planner of grasps, placements and motions for skills.

    Attributes:
        workspace: the robot among the static obstacles.
        compiled: scenes compiled so far.
    """

    workspace: Workspace
    compiled: CompiledScenes = field(default_factory=CompiledScenes)

    @classmethod
    def of(cls, scene: Scene) -> SkillPlanner:
        """Create a planner for the scene's robot and static obstacles, and for every arrangement of its objects."""
        return cls(Workspace.of(scene.robot, scene, grasps="side"))

    def grasps(self, scene: Scene, skill: Skill) -> tuple[GraspCandidate, ...] | SkillFailure:
        """Free grasps for the skill, best first."""
        found = self.options(scene, skill)
        free = [option for option in found if option.blockers == 0]
        if not free:
            return SkillFailure("blocked" if found else "unreachable")
        return tuple(sorted(free, key=lambda option: -option.quality))

    def in_the_way(self, scene: Scene, skill: Skill) -> tuple[str, ...]:
        """Names of the objects in the way of the least obstructed grasp. Empty if no grasp exists."""
        options = self.options(scene, skill)
        if not options:
            return ()
        return scene.names_of(min(options, key=lambda each: (each.blockers.bit_count(), -each.quality)).blockers)

    def options(self, scene: Scene, skill: Skill) -> list[GraspCandidate]:
        """Grasps for the skill, with the blockers of each."""
        body, step = scene.body(skill.object), 2 * np.pi / DIRECTIONS
        grasps = generate_grasps(body, scene.robot)
        if skill.direction is not None:
            away = [(grasp.yaw - skill.direction * step + np.pi) % (2 * np.pi) - np.pi for grasp in grasps]
            grasps = tuple(grasp for grasp, turn in zip(grasps, away, strict=True) if abs(turn) <= step / 2 + _EDGE)
        return self.candidates(scene, body, grasps)

    def candidates(self, scene: Scene, body: Body, grasps: Sequence[GraspPose]) -> list[GraspCandidate]:
        """Grasps of an object at some gripper poses, with the blockers of each."""
        if not grasps:
            return []
        world = self.compiled.world(scene)
        wanted = gripper_poses(grasps)
        opening = max(grasp.opening for grasp in grasps)
        placer = self.workspace.arms[scene.robot.arm_name]
        bases, index = placer.bases(wanted)
        ignore = scene.mask({body.name})
        poses = GripperPoses(bases, wanted[index])
        found = scan_configurations(world, poses, ConfigurationGrid.over(placer.chain), opening, ignore=ignore)
        return as_candidates(body.name, poses, opening, found, scene.robot.arm_name)

    def placements(self, scene: Scene, target: str, rng: np.random.Generator) -> Iterator[Placement]:
        """Placements of the held object that keep clear of the target's least obstructed grasp, best first."""
        assert scene.held is not None
        keep_clear = KeepClear()
        if scene.held.name != target and target in scene.names:
            # The held object leaves anyway, so it is no obstacle of a grasp.
            held = scene.mask({scene.held.name})
            options = self.options(scene, Skill(target))
            keep_clear = KeepClear(
                min(options, key=lambda each: ((each.blockers & ~held).bit_count(), -each.quality), default=None)
            )
        return self.workspace.placements().find(self.compiled.world(scene), keep_clear, _CLEARANCE_REGION, rng)

    def simulate_kinematically(
        self, scene: Scene, target: str, skill: Skill, rng: np.random.Generator
    ) -> Scene | SkillFailure:
        """Simulate a skill as if every motion succeeds. A target is held afterwards."""
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
        """Plan the motions of a skill, as actions without symbols. A held object is put down first.

        Objects that are put down keep clear of the target's grasp. Raises `UnknownObject`.
        """
        motion_layer = MotionLayer(self.workspace, rng, self.compiled)
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
            if picked is None:
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
        """Plan a skill with the least obstructed grasp, as if its blockers were absent. Raises `UnknownObject`."""
        in_the_way = self.in_the_way(scene, skill)
        others = tuple(body for body in scene.objects if body.name not in in_the_way)
        return self.plan(replace(scene, objects=others), target, skill, rng)

    def _put_aside(self, motion_layer: MotionLayer, scene: Scene, target: str) -> _Planned | None:
        """Put the held object where it keeps clear of the target's grasp. None if the search fails."""
        assert scene.held is not None
        name, placements = scene.held.name, self.placements(scene, target, motion_layer.rng)
        placed = (_place(motion_layer, scene, name, one) for one in itertools.islice(placements, _PLACEMENTS))
        return next((one for one in placed if one is not None), None)


def _pick(motion_layer: MotionLayer, scene: Scene, grasp: GraspCandidate) -> _Planned | None:
    driven = motion_layer.drive_to_grasp(scene, grasp)
    motion = motion_layer.pick_up(driven.scene, grasp) if isinstance(driven, BoundMotion) else driven
    return _planned("PickUp", grasp.object, scene, driven, motion)


def _place(motion_layer: MotionLayer, scene: Scene, name: str, placement: Placement) -> _Planned | None:
    driven = motion_layer.drive_to_placement(scene, name, placement)
    motion = motion_layer.put_down(driven.scene, placement) if isinstance(driven, BoundMotion) else driven
    return _planned("PutDownGeneral", name, scene, driven, motion)


def _planned(
    name: str, target: str, scene: Scene, drive: BoundMotion | NoPath, motion: BoundMotion | BlockedBy | NoPath
) -> _Planned | None:
    """The two actions, without symbols, each with the scene before its motion. None if a motion is missing."""
    if not (isinstance(drive, BoundMotion) and isinstance(motion, BoundMotion)):
        return None
    driven = BoundAction("MoveBase", (target,), drive.trajectory, scene, target)
    return _Planned((driven, BoundAction(name, (target,), motion.trajectory, drive.scene, target)), motion.scene)
