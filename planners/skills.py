"""Skills: clear one object from one direction, or take the target; their geometry, without planning any motion.

A skill is a choice among the grasps and placements that the strategies choose from. `imagine` says what a skill leaves
behind as if every motion to a free posture existed and succeeded: a kinematic twin of the real thing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from irm.kinematics import ArmChain
from planners.collision import CollisionWorld
from planners.grasp_options import OFF_TABLE, BasePlacer, GraspOption, SamplingConfig, level_hands
from planners.lookahead import grasped
from planners.placements import Placement, PlacementSearch
from planners.poses import GraspConfig, generate_grasps
from planners.postures import HandPoses, PostureGrid, scan_postures
from planners.scene import Scene
from planners.solve import map_placer
from planners.strategies import strategy

__all__ = ["DIRECTIONS", "Skill", "SkillFailure", "SkillGeometry", "skill_geometry"]

DIRECTIONS = 6
"""Approach directions, evenly about the vertical (n of Fig. 6); each stands for the yaws within half a step of it."""
_CLEARANCE_REGION = strategy("dogar")
"""Where a cleared object may go: out of the target's grasp (eq. 1), farthest first."""
_EDGE = 1e-6
"""[rad] Yaws on the border of two directions belong to both."""


@dataclass(frozen=True)
class Skill:
    """Clear `object` by grasping it from `direction` (0 to `DIRECTIONS` - 1), or, with None, take it as the target."""

    object: str
    direction: int | None = None


@dataclass(frozen=True)
class SkillFailure:
    """Why a skill could not be done: "blocked", "unreachable", "no place", "motion" or what surprised its execution."""

    reason: str


@dataclass
class SkillGeometry:
    """Grasps and placements of skills.

    Attributes:
        placer: base poses for hand poses.
        chain: the arm.
        sampling: how finely grasps are sampled.
    """

    placer: BasePlacer
    chain: ArmChain
    sampling: SamplingConfig = field(default_factory=SamplingConfig)

    @property
    def search(self) -> PlacementSearch:
        """Finds where to put things."""
        return PlacementSearch(self.placer, self.chain)

    def grasps(self, scene: Scene, skill: Skill) -> tuple[GraspOption, ...] | SkillFailure:
        """Free grasps for the skill, best first."""
        found = self.options(scene, skill)
        free = [option for option in found if option.blockers == 0]
        if not free:
            return SkillFailure("blocked" if found else "unreachable")
        return tuple(sorted(free, key=lambda option: -option.quality))

    def options(self, scene: Scene, skill: Skill) -> list[GraspOption]:
        """Grasps for the skill with what is in the way of each."""
        body = scene.body(skill.object)
        if body.bottom < scene.support.top - OFF_TABLE:
            return []
        grasps = generate_grasps(body, scene.robot, GraspConfig(directions=self.sampling.directions))
        chosen = [grasp for grasp in grasps if _is_from(grasp.yaw, skill.direction)]
        if not chosen:
            return []
        world = CollisionWorld.from_scene(scene)
        hands = level_hands(chosen)
        opening = max(grasp.opening for grasp in chosen)
        bases, index = self.placer.bases(hands)
        ignore = scene.mask({body.name})
        found = scan_postures(world, self.chain, HandPoses(bases, hands[index]), self._grid, opening, ignore=ignore)
        return [
            GraspOption(body.name, bases[pair], q, float(hands[index[pair], 3]), opening, int(hits), float(quality))
            for q, pair, hits, quality in zip(found.q, found.pair, found.hits, found.quality, strict=True)
        ]

    def placements(
        self, scene: Scene, target: str, rng: np.random.Generator, planned: Placement | None = None
    ) -> Iterator[Placement]:
        """Places for the object in hand, out of the way of the target's least obstructed grasp, best first."""
        assert scene.held is not None
        if planned is not None:
            yield planned
        yield from self.search.find(scene, self._wanted_grasp(scene, target), _CLEARANCE_REGION, rng)

    def imagine(self, scene: Scene, target: str, skill: Skill, rng: np.random.Generator) -> Scene | SkillFailure:
        """The scene that the skill leaves if every motion succeeds; taking the target leaves it in hand."""
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

    def _wanted_grasp(self, scene: Scene, target: str) -> list[GraspOption]:
        assert scene.held is not None
        if scene.held.name == target:
            return []
        held = scene.mask({scene.held.name})
        options = self.options(scene, Skill(target))
        ranked = sorted(options, key=lambda o: ((o.blockers & ~held).bit_count(), -o.quality))
        return ranked[:1]

    @property
    def _grid(self) -> PostureGrid:
        torsos = np.linspace(self.chain.lower[0], self.chain.upper[0], self.sampling.torsos + 2)[1:-1]
        rolls = -np.pi + (np.arange(self.sampling.rolls) + 0.5) * (2 * np.pi / self.sampling.rolls)
        return PostureGrid(np.asarray(torsos), np.asarray(rolls))


def skill_geometry(scene: Scene) -> SkillGeometry:
    """Skills of the scene's robot between the scene's furniture; serves every arrangement of objects."""
    return SkillGeometry(map_placer(scene), ArmChain.from_robot(scene.robot))


def _is_from(yaw: float, direction: int | None) -> bool:
    """Whether an approach yaw [rad] belongs to a direction; every yaw belongs to None."""
    if direction is None:
        return True
    step = 2 * np.pi / DIRECTIONS
    away = (yaw - direction * step + np.pi) % (2 * np.pi) - np.pi
    return bool(abs(away) <= step / 2 + _EDGE)
