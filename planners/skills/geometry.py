"""Skills: clear one object from one direction, or take the target; their geometry, without planning any motion.

A skill is a choice among the grasps and placements that the strategies choose from. `simulate_kinematically` returns
the scene after a skill, if every motion to a free configuration exists and succeeds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planners.clearing.commitments import grasped
from planners.collision.world import CompiledScenes
from planners.context import PlanningContext
from planners.grasping.arm_configurations import ConfigurationGrid, GripperPoses, scan_configurations
from planners.grasping.candidates import (
    OFF_TABLE,
    GraspCandidate,
    as_candidates,
    gripper_poses,
)
from planners.grasping.grasp_poses import GraspPose, generate_grasps
from planners.placing.placements import Placement
from planners.placing.surfaces import KeepClear
from planners.scene import Body, Scene
from planners.strategies import find_strategy

DIRECTIONS = 6
"""Approach directions, evenly about the vertical (n of Fig. 6); each stands for the yaws within half a step of it."""
_CLEARANCE_REGION = find_strategy("dogar")
"""A cleared object keeps clear of the target's grasp (eq. 1), the farthest location first."""
_EDGE = 1e-6
"""[rad] Yaws on the border of two directions belong to both."""


@dataclass(frozen=True)
class Skill:
    """Clear `object` by grasping it from `direction` (0 to `DIRECTIONS` - 1), or, with None, take it as the target."""

    object: str
    direction: int | None = None


@dataclass(frozen=True)
class SkillFailure:
    """Why a skill could not be done: "blocked", "unreachable", "no place", "motion", or a deviation."""

    reason: str


@dataclass
class SkillGeometry:
    """Grasps and placements of skills.

    Attributes:
        context: the robot among the static obstacles.
        compiled: scenes compiled so far.
    """

    context: PlanningContext
    compiled: CompiledScenes = field(default_factory=CompiledScenes)

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
        body = scene.body(skill.object)
        grasps = generate_grasps(body, scene.robot)
        return self.candidates(scene, body, [grasp for grasp in grasps if _is_from(grasp.yaw, skill.direction)])

    def candidates(self, scene: Scene, body: Body, grasps: Sequence[GraspPose]) -> list[GraspCandidate]:
        """Grasps of an object at some gripper poses, with what is in the way of each; none off the table."""
        if not grasps or body.bottom < scene.support.top - OFF_TABLE:
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


def skill_geometry(scene: Scene) -> SkillGeometry:
    """Skills of the scene's robot among the scene's static obstacles, for every arrangement of its objects."""
    return SkillGeometry(PlanningContext.of(scene.robot, scene, grasps="side"))


def _is_from(yaw: float, direction: int | None) -> bool:
    """Whether an approach yaw [rad] belongs to a direction; every yaw belongs to None."""
    if direction is None:
        return True
    step = 2 * np.pi / DIRECTIONS
    away = (yaw - direction * step + np.pi) % (2 * np.pi) - np.pi
    return bool(abs(away) <= step / 2 + _EDGE)
