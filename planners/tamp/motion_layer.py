"""Binding references to motions: each action of the task plan becomes a verified trajectory, or a reason why not."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planners.clearing.commitments import CandidateSource, ExcludingObjects, NoCommitment, never
from planners.clearing.lookahead import ClearancePlan, OrderByTaskPlan, RejectedGrasps, commitments_for
from planners.clearing.minimum_clearances import FloorLimits
from planners.collision.world import CollisionWorld
from planners.grasping.candidates import GraspCandidate, GraspCandidates
from planners.motion.arm import FIXED_BITS, ArmPath, BlockedBy, NoPath
from planners.motion.base import plan_base
from planners.motion.mujoco_check import MujocoCollisionChecker
from planners.motion.pick_and_place import PickMotion, PlaceMotion, can_leave, plan_pick, plan_place
from planners.motion.tcp_following import TcpFollower, follow
from planners.motion.timing import drive_trajectory, pick_trajectory, place_trajectory
from planners.motion.trajectory import Trajectory
from planners.placing.placements import Placement, PlacementSearch
from planners.scene import RobotState, Scene
from planners.strategies import Strategy

__all__ = ["BoundMotion", "MotionLayer"]

Array = NDArray[np.float64]

_TRIES = 2
"""Motions tried, with other random choices, where MuJoCo finds fault with the first."""


@dataclass(frozen=True, eq=False)
class BoundMotion:
    """A motion behind an action, and the scene it leaves.

    `placement` and `location` are set where the motion leads to a put-down: what is going to happen there, and the
    symbol it happens at.
    """

    trajectory: Trajectory
    scene: Scene
    placement: Placement | None = None
    location: str = ""


@dataclass
class MotionLayer:
    """The motion layer as Algorithm 1 sees it. Owns what is worth keeping between its calls."""

    candidates: GraspCandidates
    placement_search: PlacementSearch
    rng: np.random.Generator
    floor_limits: FloorLimits | None = None
    follower: TcpFollower | None = None
    is_timed_out: Callable[[], bool] = never
    has_banned: bool = False
    _checker: MujocoCollisionChecker | None = None
    _world: CollisionWorld | None = None
    _put_down: dict[int, tuple[Placement, BoundMotion | BlockedBy | NoPath]] = field(default_factory=dict)

    def choose_grasps(
        self, strategy: Strategy, scene: Scene, target: str, arrange: OrderByTaskPlan, cleared: Sequence[str] = ()
    ) -> ClearancePlan | NoCommitment:
        """The first way to go about it that the strategy can think of, through grasps that the hand can leave again.

        What was `cleared` before is cleared again only if nothing else helps, if the strategy leaves it alone.
        """
        left_alone = frozenset(cleared) if strategy.leaves_cleared else frozenset()
        found = self._choose_grasps(strategy, ExcludingObjects(self.candidates, left_alone), scene, target, arrange)
        if isinstance(found, NoCommitment) and left_alone and not self.is_timed_out():
            return self._choose_grasps(strategy, self.candidates, scene, target, arrange)
        return found

    def _choose_grasps(
        self, strategy: Strategy, source: CandidateSource, scene: Scene, target: str, arrange: OrderByTaskPlan
    ) -> ClearancePlan | NoCommitment:
        while True:
            found = commitments_for(
                strategy,
                source,
                self.placement_search,
                scene,
                target,
                arrange,
                self.rng,
                self.floor_limits,
                lambda grasp: can_leave(self._compiled(scene), grasp.base, grasp.q, grasp.object),
                self.is_timed_out,
            )
            if not isinstance(found, RejectedGrasps):
                return found
            for grasp in found.grasps:
                self.ban(scene, grasp)

    def ban(self, scene: Scene, grasp: GraspCandidate) -> None:
        """Do not offer a grasp again: no motion leads to it."""
        self.has_banned = True
        self.candidates.ban(scene, grasp)

    def obstruct(self, scene: Scene, grasp: GraspCandidate, blockers: frozenset[str]) -> None:
        """Remember what is in the way of a grasp besides what it hits itself; ban it if that is nothing new.

        An object that is in the way of its own grasp cannot be cleared for it.
        """
        mask = scene.mask(blockers - {grasp.object})
        if mask & ~grasp.blockers:
            self.candidates.obstruct(scene, grasp, mask)
        else:
            self.ban(scene, grasp)

    def placements(
        self, scene: Scene, keep_clear: Sequence[GraspCandidate], strategy: Strategy, planned: Placement | None
    ) -> Iterator[Placement]:
        """Where the object in hand may be put: the place planned for it, then others."""
        first = () if planned is None else (planned,)
        others = self.placement_search.find(scene, keep_clear, strategy, self.rng)
        return itertools.islice(itertools.chain(first, others), strategy.placements)

    def drive(self, scene: Scene, base: Array) -> BoundMotion | NoPath:
        """Drive to a base pose in the present configuration."""
        found = plan_base(self._compiled(scene), scene.state.base, base, scene.state.q, held=scene.held)
        if isinstance(found, NoPath):
            return found
        trajectory = drive_trajectory(scene.robot, found, scene.state)
        state = RobotState(np.asarray(base), scene.state.q, scene.state.finger_position)
        bound = self._followed(scene, BoundMotion(trajectory, scene.with_state(state)), ())
        return NoPath("the arm in tow touches something") if isinstance(bound, BlockedBy) else bound

    def pick_up(self, scene: Scene, grasp: GraspCandidate) -> BoundMotion | BlockedBy | NoPath:
        """Take an object through a grasp from where the base stands, and carry it."""
        world = self._compiled(scene)
        for _ in range(_TRIES):
            motion = plan_pick(world, scene.state.base, scene.state.q, grasp.q, grasp.object, rng=self.rng)
            if not isinstance(motion, PickMotion):
                return motion
            if self._is_accepted(scene, motion.paths):
                return self._followed(scene, _picked(scene, motion), (grasp.object,))
        return NoPath("MuJoCo finds penetration")

    def put_down(self, scene: Scene, placement: Placement) -> BoundMotion | BlockedBy | NoPath:
        """Put the object in hand down as planned; asked again for the same placement, the answer is the same."""
        known = self._put_down.get(id(placement))
        if known is None or known[0] is not placement:
            known = placement, self._plan_put_down(scene, placement)
            self._put_down[id(placement)] = known
        return known[1]

    def _plan_put_down(self, scene: Scene, placement: Placement) -> BoundMotion | BlockedBy | NoPath:
        assert scene.held is not None
        world = self._compiled(scene)
        for _ in range(_TRIES):
            motion = plan_place(
                world, placement.base, scene.state.q, placement.q, scene.held, rng=self.rng, find_blockers=False
            )
            if not isinstance(motion, PlaceMotion):
                return motion
            if self._is_accepted(scene, motion.paths[:2]) and self._is_accepted(
                scene.with_held(None).with_body(motion.placed), motion.paths[2:]
            ):
                return self._followed(scene, _placed(scene, motion, placement), (scene.held.name,))
        return NoPath("MuJoCo finds penetration")

    def _followed(self, scene: Scene, bound: BoundMotion, touched: tuple[str, ...]) -> BoundMotion | BlockedBy | NoPath:
        """The same motion; of a robot that is told TCP poses, if its joints find a way that is free, else why not."""
        if self.follower is None:
            return bound
        way = follow(self.follower, scene.robot, np.array(scene.state.q), bound.trajectory)
        if way is None:
            return NoPath("the hand gets stuck on the way")
        world = self._compiled(scene).with_padding(0.0)
        hits = way.hits(world, scene.mask(touched))
        if hits & FIXED_BITS:
            return NoPath(f"on its own way the arm touches {', '.join(world.names_of(hits))}")
        if hits:
            return BlockedBy(frozenset(world.names_of(hits)), "following")
        state = RobotState(bound.scene.state.base, way.end, bound.scene.state.finger_position)
        return replace(bound, scene=bound.scene.with_state(state))

    def _compiled(self, scene: Scene) -> CollisionWorld:
        if self._world is None or self._world.scene.objects != scene.objects:
            self._world = CollisionWorld.from_scene(scene)
        return self._world

    def _is_accepted(self, scene: Scene, paths: Sequence[ArmPath]) -> bool:
        """MuJoCo is the referee of every path."""
        if self._checker is None:
            self._checker = MujocoCollisionChecker(scene)
        self._checker.move_to(scene)
        return all(self._checker.accepts(path) for path in paths)


def _picked(scene: Scene, motion: PickMotion) -> BoundMotion:
    trajectory = pick_trajectory(scene.robot, motion, scene.state)
    state = RobotState(scene.state.base, motion.retreat.end, float(trajectory.finger_position[-1]))
    return BoundMotion(trajectory, scene.with_state(state).with_held(motion.held))


def _placed(scene: Scene, motion: PlaceMotion, placement: Placement) -> BoundMotion:
    trajectory = place_trajectory(scene.robot, motion, scene.state)
    state = RobotState(placement.base, motion.retreat.end, float(trajectory.finger_position[-1]))
    return BoundMotion(trajectory, scene.with_state(state).with_held(None).with_body(motion.placed))
