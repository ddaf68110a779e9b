"""The motion layer: grasps, placements and verified trajectories for the actions of a task plan."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planners.cause import Cause
from planners.clearing.commitments import ExcludingObjects, NoCommitment
from planners.clearing.lookahead import ClearancePlan, ClearingProblem, OrderByTaskPlan, commitments_for
from planners.clearing.minimum_clearances import FloorLimits
from planners.clearing.second_moves import plan_with_second_moves
from planners.clock import NO_DEADLINE, Deadline
from planners.collision.world import CollisionWorld
from planners.grasping.candidates import GraspCandidate, GraspCandidates
from planners.motion.approaches import stand_off
from planners.motion.arm import ArmPath, BlockedBy, NoPath
from planners.motion.base import plan_base
from planners.motion.homing import is_among_objects, is_at_home, plan_home
from planners.motion.mujoco_check import MujocoCollisionChecker
from planners.motion.pick_and_place import PickMotion, PlaceMotion, fewest_blockers, plan_pick, plan_place
from planners.motion.tcp_following import TcpFollower, follow
from planners.motion.timing import drive_trajectory, pick_trajectory, place_trajectory
from planners.motion.trajectory import Trajectory
from planners.motion.whole_body_path import WholeBodyPath
from planners.placing.placements import Placement, PlacementSearch
from planners.placing.surfaces import KeepClear
from planners.scene import RobotState, Scene
from planners.scene.cover import is_covered
from planners.scene.masks import FIXED_BITS
from planners.strategies import Strategy
from planners.tamp.bound_motion import BoundMotion
from planners.tamp.usable_grasps import UsableGrasps

__all__ = ["BoundMotion", "MotionLayer"]

Array = NDArray[np.float64]

_TRIES = 2
"""Motions tried, with other random choices, where MuJoCo finds fault with the first."""


@dataclass
class MotionLayer:
    """What Algorithm 1 asks for grasps, placements and motions. It remembers which grasps motion planning refuted.

    Attributes:
        candidates: grasps, and the scenes compiled so far.
        placement_search: finds where to put objects.
        rng: for sampling.
        floor_limits: of the search for the smallest self-clearable sets.
        follower: model of how the joints follow, for a robot that is told TCP poses.
        deadline: when to give up.
        joins_motions: whether what is done between two contacts becomes one motion; else every phase ends at rest.
        saves_time: whether strategies that plan ahead choose grasps that take less time.
        has_refuted: whether a grasp was refuted by motion planning.
    """

    candidates: GraspCandidates
    placement_search: PlacementSearch
    rng: np.random.Generator
    floor_limits: FloorLimits | None = None
    follower: TcpFollower | None = None
    deadline: Deadline = NO_DEADLINE
    joins_motions: bool = True
    saves_time: bool = False
    has_refuted: bool = False
    _checkers: dict[str, MujocoCollisionChecker] = field(default_factory=dict)
    _is_usable: UsableGrasps = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._is_usable = UsableGrasps(self.candidates.compiled)

    def choose_grasps(
        self,
        strategy: Strategy,
        scene: Scene,
        target: str,
        order_by_task_plan: OrderByTaskPlan,
        cleared: Sequence[str] = (),
        holds_aside: bool = False,
    ) -> ClearancePlan | NoCommitment:
        """The strategy's commitments for a scene, to grasps that the gripper can leave again.

        With `holds_aside` the last obstacle may stay in one gripper while another one takes the target. What was
        `cleared` before is cleared again only if nothing else helps, if the strategy leaves it alone.
        """
        left_alone = frozenset(cleared) if strategy.leaves_cleared else frozenset()
        problem = ClearingProblem(
            strategy,
            scene,
            target,
            ExcludingObjects(self.candidates, left_alone),
            self.placement_search,
            self.candidates.compiled,
            self.rng,
            self.floor_limits,
            self.deadline,
            self.saves_time,
            holds_aside,
        )
        found = self._usable_commitments(problem, order_by_task_plan)
        if isinstance(found, NoCommitment) and left_alone and not self.deadline.is_over:
            problem = replace(problem, candidates=self.candidates)
            found = self._usable_commitments(problem, order_by_task_plan)
        if not isinstance(found, NoCommitment) or found.cause is not Cause.NO_CLEARANCE_LOCATION:
            return found
        second_moves = strategy.second_moves - (len(cleared) - len(set(cleared)))
        non_monotone = plan_with_second_moves(
            problem, order_by_task_plan, self._is_usable, self.candidates.blank_copy, second_moves
        )
        return non_monotone or found

    def _reject(self, scene: Scene, grasp: GraspCandidate) -> None:
        """Add to a grasp that is not usable what is in the way of its straight lines, or do not offer it again."""
        world = self._compiled(scene).for_arm(grasp.arm)
        blockers = fewest_blockers(world, grasp.base, grasp.q, grasp.object) if grasp.drives else None
        if blockers is None:
            self.ban(scene, grasp)
        else:
            self.candidates.obstruct(scene, grasp, blockers)

    def _usable_commitments(
        self, problem: ClearingProblem, order_by_task_plan: OrderByTaskPlan
    ) -> ClearancePlan | NoCommitment:
        """The first commitments to grasps that are all usable; those that are not are rejected on the way."""
        while True:
            found = commitments_for(problem, order_by_task_plan, self._is_usable)
            if isinstance(found, NoCommitment):
                return self._with_cause(found)
            if isinstance(found, ClearancePlan):
                return found
            for grasp in found.grasps:
                self._reject(problem.scene, grasp)

    def _with_cause(self, found: NoCommitment) -> NoCommitment:
        """Where grasps were refuted by motion planning, it is not the grasps alone that leave no commitments."""
        is_refuted = self.has_refuted and found.cause.lies_in_grasps
        return replace(found, cause=Cause.MOTION, proved=False) if is_refuted else found

    def ban(self, scene: Scene, grasp: GraspCandidate) -> None:
        """Do not offer a grasp again: no motion leads to it."""
        self.has_refuted = True
        self.candidates.ban(scene, grasp)

    def obstruct(self, scene: Scene, grasp: GraspCandidate, blockers: frozenset[str]) -> None:
        """Remember what is in the way of a grasp besides what it hits itself; ban it if that is nothing new.

        An object that is in the way of its own grasp cannot be cleared for it.
        """
        self.has_refuted = True
        mask = scene.mask(blockers - {grasp.object})
        if mask & ~grasp.blockers:
            self.candidates.obstruct(scene, grasp, mask)
        else:
            self.ban(scene, grasp)

    def placements(
        self, scene: Scene, keep_clear: KeepClear, strategy: Strategy, planned: Placement | None
    ) -> Iterator[Placement]:
        """Where the held object may be put: the placement planned for it, then others."""
        first = () if planned is None else (planned,)
        others = self.placement_search.find(self._compiled(scene), keep_clear, strategy, self.rng, self.deadline)
        return itertools.islice(itertools.chain(first, others), strategy.placements)

    def drive_to_grasp(self, scene: Scene, grasp: GraspCandidate) -> BoundMotion | NoPath:
        """Drive to where the pick begins: the base pose of the grasp, or where the base leaves it to under a board.

        Where another arm will take the object, the active one moves home first.
        """
        base = stand_off(scene.using(grasp.arm), grasp.base, grasp.q) if grasp.drives else grasp.base
        return self.drive(scene, base, home_first=self._next_arm(scene, grasp.arm) is None)

    def drive_to_placement(self, scene: Scene, placement: Placement) -> BoundMotion | NoPath:
        """Drive to where the put-down begins, as for a grasp."""
        return self.drive(scene, _start_of_put_down(scene, placement))

    def bring_home(self, scene: Scene) -> BoundMotion | NoPath:
        """Bring the arm home, with what it holds, where the base stands."""
        return self.drive(scene, scene.state.base, home_first=True)

    def drive(self, scene: Scene, base: Array, home_first: bool = False) -> BoundMotion | NoPath:
        """Drive to a base pose in the present configuration; among objects the arm moves home first, if it can."""
        world, state = self._compiled(scene), scene.state
        homing = self._home(scene) if home_first or is_among_objects(world, state) else None
        found = plan_base(world, state.base, base, state.q if homing is None else homing.end, held=scene.held)
        if isinstance(found, NoPath) and homing is None:
            homing = self._home(scene)
            found = found if homing is None else plan_base(world, state.base, base, homing.end, held=scene.held)
        if isinstance(found, NoPath):
            return found
        trajectory = drive_trajectory(scene.robot, found, scene.state, homing)
        state = RobotState(found.waypoints[-1], found.q, float(trajectory.finger_position[-1]))
        bound = self._followed(scene, BoundMotion(trajectory, scene.with_state(state)), ())
        return NoPath("following the base, the arm touches something") if isinstance(bound, BlockedBy) else bound

    def _next_arm(self, scene: Scene, arm: str) -> Scene | None:
        """The scene with that arm active; None where another arm is active and not at home."""
        is_ready = arm == scene.robot.arm_name or is_at_home(self._compiled(scene), scene.state)
        return scene.using(arm) if is_ready else None

    def _home(self, scene: Scene) -> ArmPath | None:
        """The arm's way home, if one is found and accepted."""
        home = plan_home(self._compiled(scene), scene.state, self.rng)
        return home if isinstance(home, ArmPath) and self.is_accepted(scene, [home]) else None

    def pick_up(self, scene: Scene, grasp: GraspCandidate) -> BoundMotion | BlockedBy | NoPath:
        """Take an object through a grasp with its arm, and carry it."""
        turn = self._next_arm(scene, grasp.arm)
        if turn is None:
            return NoPath("the other arm is not at home")
        scene, world = turn, self._compiled(turn)
        for _ in range(_TRIES):
            motion = plan_pick(world, grasp.base, _whole_body(scene.state), grasp.q, grasp.object, rng=self.rng)
            if not isinstance(motion, PickMotion):
                return motion
            if self.is_accepted(scene, motion.paths):
                return self._followed(scene, _after_pick(scene, motion), (grasp.object,))
        return NoPath("MuJoCo finds penetration")

    def put_down(self, scene: Scene, placement: Placement) -> BoundMotion | BlockedBy | NoPath:
        """Put the held object down as planned."""
        assert scene.held is not None
        world, held, start = self._compiled(scene), scene.held, _whole_body(scene.state)
        for _ in range(_TRIES):
            motion = plan_place(world, placement.base, start, placement.q, held, rng=self.rng, find_blockers=False)
            if not isinstance(motion, PlaceMotion):
                return motion
            if self.is_accepted(scene, motion.paths[:2]) and self.is_accepted(
                scene.with_held(None).with_body(motion.placed), motion.paths[2:]
            ):
                return self._followed(scene, _after_put_down(scene, motion, placement), (scene.held.name,))
        return NoPath("MuJoCo finds penetration")

    def _followed(self, scene: Scene, bound: BoundMotion, touched: tuple[str, ...]) -> BoundMotion | BlockedBy | NoPath:
        """The same motion; for a robot that is told TCP poses, with the joint path that follows it, or why not."""
        bound = replace(bound, before=scene)
        if self.follower is None:
            return bound
        followed = follow(self.follower, scene.robot, np.array(scene.state.q), bound.trajectory)
        if followed is None:
            return NoPath("the TCP cannot follow the trajectory")
        world = self._compiled(scene).with_padding(0.0)
        hits = followed.hits(world, scene.mask(touched))
        if hits & FIXED_BITS:
            return NoPath(f"following the TCP, the arm touches {', '.join(world.names_of(hits))}")
        if hits:
            return BlockedBy(frozenset(world.names_of(hits)), "following")
        state = RobotState(bound.scene.state.base, followed.end, bound.scene.state.finger_position)
        return replace(bound, scene=bound.scene.with_state(state))

    def _compiled(self, scene: Scene) -> CollisionWorld:
        return self.candidates.compiled.world(scene)

    def is_accepted(self, scene: Scene, paths: Sequence[WholeBodyPath | ArmPath | Trajectory]) -> bool:
        """Whether MuJoCo finds no penetration on any of the paths."""
        arm = scene.robot.arm_name
        if arm not in self._checkers:
            self._checkers[arm] = MujocoCollisionChecker(scene)
        self._checkers[arm].move_to(scene)
        return all(self._checkers[arm].accepts(path) for path in paths)


def _whole_body(state: RobotState) -> Array:
    """(11,) base pose, torso and arm."""
    return np.concatenate((state.base, state.q))


def _start_of_put_down(scene: Scene, placement: Placement) -> Array:
    """The base pose (3,) from which the base drives straight in under a board to put an object down."""
    is_inside = is_covered(scene, placement.body.foot)
    return stand_off(scene, placement.base, placement.q) if is_inside else placement.base


def _after_pick(scene: Scene, motion: PickMotion) -> BoundMotion:
    """The motion of a pick, and the scene in which the object is carried."""
    trajectory = pick_trajectory(scene.robot, motion, scene.state)
    state = RobotState(motion.retreat.end_base, motion.retreat.end, float(trajectory.finger_position[-1]))
    return BoundMotion(trajectory, scene.with_state(state).with_held(motion.held))


def _after_put_down(scene: Scene, motion: PlaceMotion, placement: Placement) -> BoundMotion:
    """The motion of a put-down, and the scene in which the object stands where it was put."""
    trajectory = place_trajectory(scene.robot, motion, scene.state)
    state = RobotState(motion.retreat.end_base, motion.retreat.end, float(trajectory.finger_position[-1]))
    placed = scene.with_held(None).with_state(state).with_body(motion.placed)
    return BoundMotion(trajectory, placed, surfaces=placement.surfaces)
