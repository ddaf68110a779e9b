"""Skills as motions: the trajectories behind clearing one object, or taking the target."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from planners.grasping.candidates import GraspCandidate, GraspCandidates
from planners.motion.arm import BlockedBy, NoPath
from planners.scene import Scene
from planners.skills.geometry import Skill, SkillFailure, SkillGeometry
from planners.tamp.motion_layer import BoundMotion, MotionLayer
from planners.tamp.solution import BoundAction

__all__ = ["SkillPlanner"]

_GRASPS = 3
"""Grasps tried before a skill counts as failed."""
_PLACEMENTS = 8
"""Placements tried for each of them."""


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
        candidates = GraspCandidates(geometry.placer, geometry.chain, compiled=geometry.compiled)
        motion_layer = MotionLayer(candidates, geometry.search, self.rng)
        done: tuple[BoundAction, ...] = ()
        if scene.held is not None:
            emptied = self._put_down(motion_layer, scene, target)
            if isinstance(emptied, SkillFailure):
                return emptied
            done, scene = emptied
        grasps = self.geometry.grasps(scene, skill)
        if isinstance(grasps, SkillFailure):
            return grasps
        failure = SkillFailure("motion")
        for grasp in grasps[:_GRASPS]:
            taken = _take(motion_layer, scene, grasp)
            if taken is None:
                continue
            actions, in_hand = taken
            if skill.direction is None:
                return (*done, *actions)
            placed = self._put_down(motion_layer, in_hand, target)
            if not isinstance(placed, SkillFailure):
                return (*done, *actions, *placed[0])
            failure = placed
        return failure

    def plan_through(self, scene: Scene, target: str, skill: Skill) -> tuple[BoundAction, ...] | SkillFailure:
        """As `plan`, by the least obstructed grasp, and as if what is in its way were not there.

        Raises:
            UnknownObject: no object of that name.
        """
        in_the_way = self.geometry.in_the_way(scene, skill)
        others = tuple(body for body in scene.objects if body.name not in in_the_way)
        return self.plan(replace(scene, objects=others), target, skill)

    def _put_down(
        self, motion_layer: MotionLayer, scene: Scene, target: str
    ) -> tuple[tuple[BoundAction, ...], Scene] | SkillFailure:
        """Put the held object where it keeps clear of the target's grasp."""
        assert scene.held is not None
        name = scene.held.name
        for placement in itertools.islice(self.geometry.placements(scene, target, self.rng), _PLACEMENTS):
            driven = motion_layer.drive_to_placement(scene, placement)
            if isinstance(driven, NoPath):
                continue
            placed = motion_layer.put_down(driven.scene, placement)
            if isinstance(placed, BoundMotion):
                actions = (
                    _action("MoveBase", name, scene, driven),
                    _action("PutDownGeneral", name, driven.scene, placed),
                )
                return actions, placed.scene
        return SkillFailure("no place")


def _take(
    motion_layer: MotionLayer, scene: Scene, grasp: GraspCandidate
) -> tuple[tuple[BoundAction, ...], Scene] | None:
    """Drive there and pick the object up; None where no motion is found."""
    driven = motion_layer.drive_to_grasp(scene, grasp)
    if isinstance(driven, NoPath):
        return None
    picked = motion_layer.pick_up(driven.scene, grasp)
    if isinstance(picked, BlockedBy | NoPath):
        return None
    actions = (
        _action("MoveBase", grasp.object, scene, driven),
        _action("PickUp", grasp.object, driven.scene, picked),
    )
    return actions, picked.scene


def _action(name: str, target: str, scene: Scene, motion: BoundMotion) -> BoundAction:
    """An action without symbols, and the scene in which its motion was planned."""
    return BoundAction(name, (target,), motion.trajectory, scene, target)
