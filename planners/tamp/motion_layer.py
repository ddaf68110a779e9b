"""The motion layer: grasps, placements and verified trajectories for the actions of a task plan."""

from __future__ import annotations

import itertools
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planners.clearing.clearance_plan import ClearancePlan
from planners.clearing.commitments import NoCommitment, commitments_for
from planners.clearing.goal_bound import LowerBound
from planners.clearing.lookahead import look_ahead
from planners.clearing.moves import MoveMaker, NotPlaced
from planners.clock import NO_DEADLINE, Deadline
from planners.collision.opened import riding, without_moving
from planners.collision.world import CollisionWorld, CompiledScenes, with_clearance_around, with_clearance_at_ends
from planners.goals import Goal, holding
from planners.grasping.candidates import GraspCandidate, GraspCandidates
from planners.motion.approaches import is_handle, stand_off
from planners.motion.arm import ArmQuery, is_among_objects, is_at_home, plan_arm, plan_home, unwrap_joints
from planners.motion.base import plan_base
from planners.motion.contact_free import merge_phases
from planners.motion.kept import KeptMotions
from planners.motion.mujoco_check import STEP, TOLERANCE, MujocoCollisionChecker, signature
from planners.motion.path import NO_WAY, BlockedBy, NoPath, WholeBodyPath, on_base
from planners.motion.pick_and_place import PickPlaceMotion, plan_pick, plan_place
from planners.motion.pulling import PullMotion, plan_pull
from planners.motion.tcp_following import follow
from planners.motion.timing import drive_trajectory, pick_trajectory, place_trajectory, pull_trajectory
from planners.motion.trajectory import Trajectory, is_contact, join, phases_of
from planners.placing.goal_places import placed_fact, reserved_regions
from planners.placing.placements import Placement, PlacementSearch, with_lowered
from planners.placing.surfaces import KeepClear, Surface
from planners.problem import Problem
from planners.scene import Body, HeldObject, RobotState, Scene
from planners.scene.cover import needs_drive
from planners.scene.masks import FIXED_BITS
from planners.strategies import Strategy
from planners.tamp.solution import BoundAction
from planners.workspace import Workspace

Array = NDArray[np.float64]

_TRIES = 2
"""Motions to try, with different random choices, if MuJoCo finds a collision in the first."""


@dataclass(frozen=True, eq=False)
class BoundMotion:
    """Motion of an action, and the scene after it.

    Attributes:
        trajectory: the verified motion.
        scene: the scene after it.
        surfaces: for a put-down, the supports that were searched, with their keep-out regions for the object.
        location: for a drive to a put-down, the symbol of the location.
        put_down: for the same drive, the put-down itself. It is planned before the base moves there.
        before: the scene in which the motion was planned, with the motion's arm active.
    """

    trajectory: Trajectory
    scene: Scene
    location: str = ""
    put_down: BoundMotion | None = None
    surfaces: tuple[Surface, ...] = ()
    before: Scene | None = None


@dataclass
class MotionLayer:
    """Planner of grasps, placements and motions for Algorithm 1. It remembers what motion planning refuted.

    Attributes:
        workspace: the robot among the static obstacles.
        rng: for sampling.
        compiled: the collision worlds of the scenes so far.
        deadline: when to stop.
        motions: cache of the motions planned so far, in earlier scenes too.
        checkers: MuJoCo's models of scenes so far.
        not_placed: objects for whose goal places no motion was found so far.
        candidates: the grasps known in the present state.
        placement_search: search for placements, with the swept volumes of grasps.
        checks_at_end: whether MuJoCo checks motions only once, when they are `shortened`.
        is_refuted: whether that late check refuted a motion. The plan must then be made again with a check of each
            motion.
        is_in_vain: whether another attempt is: no hand can release an object at its place.
    """

    workspace: Workspace
    rng: np.random.Generator
    compiled: CompiledScenes = field(default_factory=CompiledScenes)
    deadline: Deadline = NO_DEADLINE
    motions: KeptMotions = field(default_factory=KeptMotions)
    checkers: dict[Hashable, MujocoCollisionChecker] = field(default_factory=dict, repr=False)
    checks_at_end: bool = False
    is_refuted: bool = False
    is_in_vain: bool = False
    not_placed: NotPlaced = field(default_factory=NotPlaced)
    candidates: GraspCandidates = field(init=False, repr=False)
    placement_search: PlacementSearch = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.candidates, self.placement_search = self.workspace.grasps(self.compiled), self.workspace.placements()

    def with_known(self, before: MotionLayer | None) -> MotionLayer:
        """Take over the grasps and placements of an earlier motion layer for the same workspace, if given."""
        if before is not None:
            self.candidates, self.placement_search = before.candidates, before.placement_search
            self.not_placed = before.not_placed
        return self

    @property
    def has_refuted(self) -> bool:
        """Whether motion planning has refuted a grasp."""
        return self.candidates.refuted > 0

    def choose_grasps(
        self, strategy: Strategy, scene: Scene, target: str, cleared: Sequence[str]
    ) -> ClearancePlan | NoCommitment:
        """Choose grasps for a strategy that does not plan ahead, such that the gripper can approach and retreat.

        A strategy may leave objects alone that were `cleared` before. They are cleared again only if nothing else
        helps.
        """
        maker = self.maker(strategy, holding(target), scene)
        left_alone = frozenset(cleared) if strategy.leaves_cleared else frozenset[str]()
        while True:
            found = commitments_for(
                lambda name: () if name in left_alone else self.candidates.for_object(scene, name),  # noqa: B023
                scene,
                target,
                strategy,
                self.deadline,
            )
            if isinstance(found, NoCommitment):
                if left_alone and not self.deadline.is_over:
                    left_alone = frozenset()
                    continue
                return found
            unusable = [grasp for grasp in found.grasps.values() if not maker.is_usable(scene, grasp)]
            if not unusable:
                return ClearancePlan(found)
            for grasp in unusable:
                maker.reject(scene, grasp)

    def maker(
        self,
        strategy: Strategy,
        goal: Goal,
        start: Scene,
        not_placed: NotPlaced | None = None,
        holds_aside: bool = False,
    ) -> MoveMaker:
        """Build the maker of moves for a goal from the grasps and placements known so far."""
        return MoveMaker(
            goal,
            start,
            strategy,
            self.candidates,
            self.placement_search,
            self.rng,
            self.deadline,
            not_placed or NotPlaced(),
            holds_aside,
            self.workspace.saves_time,
            self.workspace.hurries,
        )

    def plan_goal(self, maker: MoveMaker, scene: Scene) -> ClearancePlan | NoCommitment:
        """Plan the moves for a goal with `planners.clearing.lookahead.look_ahead`."""
        self.candidates.remembers = True
        return look_ahead(maker, scene)

    def goal_placements(
        self, maker: MoveMaker, scene: Scene, keep_clear: KeepClear, plan: ClearancePlan
    ) -> Iterator[Placement]:
        """Placements of the held object for a goal: first the planned placement, then others."""
        assert scene.held is not None
        name = scene.held.name
        fact = placed_fact(maker.goal, name) if name in plan.general else None
        reserved = reserved_regions(scene, maker.goal, name if name in plan.general else "")
        others = maker.places(scene, fact, replace(keep_clear, reserved=reserved), plan.commitments.grasps)
        return itertools.islice(itertools.chain((plan.placements[name],), others), maker.strategy.placements)

    def lower_bound(self, problem: Problem) -> LowerBound:
        """Lower bound of the picks for a problem, not exact under a shelf. The grasps computed for it are kept."""
        found = problem.first_bound(deadline=self.deadline, is_exact=False)
        self.candidates.learn(problem.candidates)
        return found

    def ban(self, scene: Scene, grasp: GraspCandidate) -> None:
        """Exclude a grasp: no motion leads to it."""
        self.candidates.ban(scene, grasp)

    def obstruct(self, scene: Scene, grasp: GraspCandidate, blockers: frozenset[str]) -> None:
        """Add the objects in the way of a grasp's motion to its blockers. Exclude the grasp if they are all known.

        An object that blocks its own grasp cannot be cleared for it.
        """
        mask = scene.mask(blockers - {grasp.object})
        if mask & ~grasp.blockers:
            self.candidates.obstruct(scene, grasp, mask)
        else:
            self.ban(scene, grasp)

    def placements(
        self, scene: Scene, keep_clear: KeepClear, strategy: Strategy, planned: Placement | None
    ) -> Iterator[Placement]:
        """Placements of the held object: first the planned placement, then others."""
        first = () if planned is None else (planned,)
        world = self.compiled.world(scene)
        others = self.placement_search.find(world, keep_clear, strategy, self.rng, self.deadline)
        return itertools.islice(itertools.chain(first, others), strategy.placements)

    def drive_to_grasp(self, scene: Scene, grasp: GraspCandidate) -> BoundMotion | NoPath:
        """Drive to the base pose where the pick begins.

        That is the base pose of the grasp. If the base must drive under a shelf for the grasp, it is a pose in front of
        the shelf. If another arm takes the object, the active arm moves home first. If no base path exists, all grasps
        at base poses that the roadmap excludes as well are banned.
        """
        base = (
            stand_off(scene.using(grasp.arm), grasp.base, grasp.q, scene.body(grasp.object))
            if grasp.drives
            else grasp.base
        )
        turn = self._next_arm(scene, grasp.arm)
        # Driven by the arm that takes the object, the drive and its approach become one motion later.
        driven = self.drive(turn or scene, base, home_first=turn is None)
        if driven is NO_WAY:
            for other in self.candidates.for_object(scene, grasp.object):
                if other is not grasp and self.workspace.roadmap.excludes(scene.state.base, other.base):
                    self.ban(scene, other)
        return driven

    def drive_to_placement(self, scene: Scene, name: str, placement: Placement) -> BoundMotion | NoPath:
        """Drive to the base pose where the put-down of a held object begins.

        For a place under a shelf, it is in front of the shelf. If another arm holds the object, the active arm moves
        home first.
        """
        holding = scene.holding(name)
        assert holding is not None
        is_inside = needs_drive(holding, placement.body.foot)
        base = stand_off(holding, placement.base, placement.q, placement.body) if is_inside else placement.base
        if self._next_arm(scene, holding.robot.arm_name) is None:
            return self.drive(scene, base, home_first=True)
        return self.drive(holding, base)

    def bring_home(self, scene: Scene) -> BoundMotion | NoPath:
        """Bring the arm home with its load. The base stays."""
        return self.drive(scene, scene.state.base, home_first=True)

    def hold_at(self, scene: Scene, point: Array) -> BoundMotion | NoPath:
        """Bring the centre of the held object to a point (3,) [m], upright as it was taken."""
        assert scene.held is not None
        world, state = self.compiled.world(scene), scene.state
        for placement in self.placement_search.holding_at(world, point):
            driven = plan_base(
                world,
                state.base,
                placement.base,
                state.q,
                held=scene.held,
                roadmap=self.workspace.roadmap,
                deadline=self.deadline,
            )
            if isinstance(driven, NoPath):
                continue
            query, q = ArmQuery(world, driven.end_base, 0.0, scene.held), driven.end
            path = plan_arm(query, q, unwrap_joints(world.robot, q, placement.q), rng=self.rng, find_blockers=False)
            if isinstance(path, WholeBodyPath):
                joined = replace(path, configurations=np.vstack([driven.configurations, path.configurations]))
                if self.is_accepted(scene, [joined]):
                    return self._driven(scene, joined)
        return NoPath("no free motion brings it there")

    def drive(self, scene: Scene, base: Array, home_first: bool = False) -> BoundMotion | NoPath:
        """Drive to a base pose in the present arm configuration. Among objects, the arm moves home first if it can.

        Without a path, it tries again with the fingers as open as they are, then with the arm at home, then with a
        raised torso.
        """
        world, state = self.compiled.world(scene), scene.state
        homing = self._home(scene) if home_first or is_among_objects(world, state) else None
        q = state.q if homing is None else homing.end
        drive = partial(plan_base, world, state.base, base, roadmap=self.workspace.roadmap, deadline=self.deadline)
        found = drive(q, held=scene.held)
        if isinstance(found, NoPath) and homing is None and scene.held is None:
            as_open = scene.robot.opening(state.finger_position)  # a wider gripper may collide
            found = drive(q, opening=as_open)
        if isinstance(found, NoPath) and homing is None:
            homing = self._home(scene)
            if homing is not None:
                found = drive(homing.end, held=scene.held)
        if isinstance(found, NoPath):
            homing = self._raised(scene)  # gripper and load may be as low as the furniture at the goal
            if homing is not None:
                found = drive(homing.end, held=scene.held)
        if isinstance(found, NoPath):
            return found
        return self._driven(scene, found, homing)

    def can_leave(self, scene: Scene, base: Array) -> bool:
        """Whether the base can drive back to where it came from. The object just put down may block the arm."""
        q, roadmap, world = scene.state.q, self.workspace.roadmap, self.compiled.world(scene)
        back = plan_base(world, scene.state.base, base, q, roadmap=roadmap, deadline=self.deadline)
        if isinstance(back, WholeBodyPath):
            return True
        return isinstance(self.drive(scene, base), BoundMotion)

    def _driven(self, scene: Scene, path: WholeBodyPath, homing: WholeBodyPath | None = None) -> BoundMotion | NoPath:
        """Bind a drive: the path `homing` of the arm, then the path of the base. Nothing is taken or put down."""
        trajectory = drive_trajectory(self.compiled.world(scene), path, scene.state, homing)
        state = RobotState(path.end_base, path.end, float(trajectory.finger_position[-1]))
        bound = self._followed(scene, BoundMotion(trajectory, scene.with_state(state)), ())
        return NoPath("following the base, the arm touches something") if isinstance(bound, BlockedBy) else bound

    def _next_arm(self, scene: Scene, arm: str) -> Scene | None:
        """Scene with that arm active. None while another active arm is away from home."""
        is_ready = arm == scene.robot.arm_name or is_at_home(self.compiled.world(scene), scene.state)
        return scene.using(arm) if is_ready else None

    def _home(self, scene: Scene) -> WholeBodyPath | None:
        """Path of the arm to its home configuration, if found and accepted by MuJoCo."""
        home = plan_home(self.compiled.world(scene), scene.state, self.rng)
        return home if isinstance(home, WholeBodyPath) and self.is_accepted(scene, [home]) else None

    def _raised(self, scene: Scene) -> WholeBodyPath | None:
        """Path of the torso to its upper limit with base and arm fixed, if collision-free and accepted by MuJoCo."""
        world, state = self.compiled.world(scene), scene.state
        up = np.array([world.robot.upper[0], *state.q[1:]])
        path = WholeBodyPath(on_base(state.base, np.stack((state.q, up))), 0.0, scene.held)
        is_free = not world.path_hits(path.configurations, 0.0, scene.held, first_only=True)
        return path if is_free and self.is_accepted(scene, [path]) else None

    def pick_up(self, scene: Scene, grasp: GraspCandidate, rises: bool = False) -> BoundMotion | BlockedBy | NoPath:
        """Take an object with a grasp's arm and retreat with it. `rises` as for `plan_pick`."""
        turn = self._next_arm(scene, grasp.arm)
        if turn is None:
            return NoPath("the other arm is not at home")
        scene, world, start = turn, self.compiled.world(turn), np.concatenate((turn.state.base, turn.state.q))
        key = ("pick", grasp.key, world.scene.body(grasp.object).pose.tobytes(), start.tobytes(), rises)
        known, refusal = self.motions.find(key, PickPlaceMotion, world), ""
        for _ in range(_TRIES):
            motion = known or plan_pick(
                world, grasp.base, start, grasp.q, grasp.object, rng=self.rng, rises=rises, deadline=self.deadline
            )
            if not isinstance(motion, PickPlaceMotion):
                return motion
            self.motions.keep(key, motion, scene, motion.paths)
            refusal = "" if self.checks_at_end else self.refusal(scene, motion.paths)
            if not refusal:
                trajectory = pick_trajectory(world, motion, scene.state)
                carrying = scene.with_state(_end_state(motion, trajectory)).with_held(motion.held)
                return self._followed(scene, BoundMotion(trajectory, carrying), (grasp.object,))
            known = None
        return NoPath(f"MuJoCo finds penetration: {refusal}")

    def pull(self, scene: Scene, grasp: GraspCandidate) -> BoundMotion | BlockedBy | NoPath:
        """Grasp a handle, pull it, and let go. See `planners.motion.pulling`."""
        turn = self._next_arm(scene, grasp.arm)
        if turn is None:
            return NoPath("the other arm is not at home")
        scene, world, start = turn, self.compiled.world(turn), np.concatenate((turn.state.base, turn.state.q))
        motion = plan_pull(world, grasp.base, start, grasp.q, rng=self.rng, deadline=self.deadline)
        if not isinstance(motion, PullMotion):
            return motion
        refusal = self.refusal(scene, motion.paths[:2]) or self.refusal(motion.after, motion.paths[2:])
        if refusal:
            return NoPath(f"MuJoCo finds penetration: {refusal}")
        trajectory = pull_trajectory(world, motion, scene.state)
        state = RobotState(motion.home.end_base, motion.home.end, float(trajectory.finger_position[-1]))
        bound = BoundMotion(trajectory, motion.after.with_state(state))
        if self.workspace.follower is None and self.workspace.controller is None:
            return replace(bound, before=scene)
        followed = self._followed(without_moving(scene), bound, riding(scene))
        return replace(followed, before=scene) if isinstance(followed, BoundMotion) else followed

    def put_down(
        self, scene: Scene, placement: Placement, find_blockers: bool = False
    ) -> BoundMotion | BlockedBy | NoPath:
        """Put the held object down as planned. `find_blockers` as for `plan_place`."""
        assert scene.held is not None
        world, held, start = self.compiled.world(scene), scene.held, np.concatenate((scene.state.base, scene.state.q))
        world = with_lowered(world, placement.below) if placement.below else world
        ends = (placement.base.tobytes(), placement.q.tobytes(), placement.below)
        key = ("place", scene.robot.arm_name, held.key, *ends, start.tobytes())
        known, refusal = self.motions.find(key, PickPlaceMotion, world), ""
        for _ in range(_TRIES):
            motion = known or plan_place(
                world,
                placement.base,
                start,
                placement.q,
                held,
                rng=self.rng,
                find_blockers=find_blockers,
                deadline=self.deadline,
            )
            if not isinstance(motion, PickPlaceMotion):
                return motion
            self.motions.keep(key, motion, scene, motion.paths)
            released = scene.with_held(None).with_body(motion.body.lowered(placement.drop))
            if not self.checks_at_end:
                refusal = self.refusal(scene, motion.paths[:2]) or self.refusal(released, motion.paths[2:])
            if not refusal:
                trajectory = place_trajectory(world, motion, scene.state)
                left = released.with_state(_end_state(motion, trajectory))
                bound = BoundMotion(trajectory, left, surfaces=placement.surfaces)
                return self._followed(scene, bound, (held.name, *([placement.below] if placement.below else ())))
            known = None
        return NoPath(f"MuJoCo finds penetration: {refusal}")

    def _followed(self, scene: Scene, bound: BoundMotion, touched: tuple[str, ...]) -> BoundMotion | BlockedBy | NoPath:
        """Check that the controller can follow a motion without collision, and set the joints at its end.

        Without a model of the controller, the motion stays as it is. `workspace.controller` only checks: the joints at
        the end stay as planned.
        """
        bound = replace(bound, before=scene)
        follower = self.workspace.follower or self.workspace.controller
        if follower is None:
            return bound
        followed = follow(follower, scene.robot, np.array(scene.state.q), bound.trajectory)
        if followed is None:
            return NoPath("the TCP cannot follow the trajectory")
        world: CollisionWorld = self.compiled.world(scene).with_padding(0.0)
        if touched and scene.held is None and scene.pull is None:
            world = with_clearance_around(world, touched[0])  # what it touches from the start
        hits = followed.hits(world, scene.mask(touched))
        if self.workspace.follower is None:
            touches = world.names_of(hits & ~FIXED_BITS)
            return NoPath(f"following the TCP, the arm touches {', '.join(touches)}") if touches else bound
        if hits & FIXED_BITS:
            return NoPath(f"following the TCP, the arm touches {', '.join(world.names_of(hits))}")
        if hits:
            return BlockedBy(frozenset(world.names_of(hits)), "following")
        state = RobotState(bound.scene.state.base, followed.configurations[-1, 3:], bound.scene.state.finger_position)
        return replace(bound, scene=bound.scene.with_state(state))

    def shortened(self, actions: Sequence[BoundAction], end: Scene) -> tuple[BoundAction, ...]:
        """Shorten a plan: merge the motions between two contacts into one motion, where that is collision-free.

        Actions keep names, order and phases. Between merged actions the robot no longer rests. `end` is the scene after
        them.
        """
        scenes = [*(action.scene for action in actions[1:]), end]
        parts = [(index, phase) for index, action in enumerate(actions) for phase in phases_of(action.trajectory)]

        def kind(part: tuple[int, Trajectory]) -> tuple[str, bool]:
            """Properties that the phases of one merged motion share: the arm, and whether it is a contact."""
            return actions[part[0]].scene.robot.arm_name, is_contact(part[1].phases[0])

        runs = [list(run) for _, run in itertools.groupby(parts, key=kind)]
        contacts = [run[0][1].phases[0] for run in runs]
        in_contact = [phase.touched if is_contact(phase) else None for phase in contacts]
        shorter: list[list[Trajectory]] = [[] for _ in actions]
        for k, run in enumerate(runs):
            phases = [phase for _, phase in run]
            if in_contact[k] is None:
                before, after = in_contact[k - 1] if k else None, in_contact[k + 1] if k + 1 < len(runs) else None
                last, after_last = actions[run[-1][0]], scenes[run[-1][0]]
                scene = last.scene
                if last.is_put_down and before is not None and run[0][0] == run[-1][0]:
                    # This arm does nothing after the release: the object that it put down stays there.
                    scene = scene.with_held(None).with_body(after_last.body(last.target))
                elif before is not None and is_handle(scene, before.name):
                    scene = after_last  # the door or drawer as the pull left it
                is_put = after is not None and not is_handle(scene, after.name)
                put = after_last.body(after.name) if after is not None and is_put else None
                found = self._merged(scene, phases, before, after) or self._carried(scene, phases, before, after, put)
                if found is not None and self.is_accepted(scene, [join(found)]):
                    phases = found
                elif self.checks_at_end and not self.is_accepted(scene, [join(phases)]):
                    self.is_refuted = True
            for (index, _), phase in zip(run, phases, strict=True):
                shorter[index].append(phase)
        return tuple(_with_trajectory(action, join(pieces)) for action, pieces in zip(actions, shorter, strict=True))

    def _merged(
        self, scene: Scene, phases: Sequence[Trajectory], before: HeldObject | None, after: HeldObject | None
    ) -> list[Trajectory] | None:
        """Phases merged into one motion, planned now or taken from the cache. See `merge_phases`."""
        world, robot = self.compiled.world(scene), scene.robot
        touched = tuple(None if one is None else one.key for one in (before, after))
        key = ("merged", robot.arm_name, touched, *(phase.states.tobytes() for phase in phases))
        found = self.motions.find(key, list, world)
        if found is None:
            found = merge_phases(world, phases, before, after, self.workspace.hurries)
            if found is not None:
                loaded, widest = phases[0].phases[0], max(float(phase.finger_position.max()) for phase in phases)
                held = loaded.touched if loaded.held else None
                left_alone = scene.mask(one.name for one in (before, after) if one is not None)
                X = np.vstack([phase.states[:, :-1] for phase in found])
                self.motions.keep(key, found, scene, [WholeBodyPath(X, robot.opening(widest), held, left_alone)])
        return found

    def _carried(
        self,
        scene: Scene,
        phases: Sequence[Trajectory],
        before: HeldObject | None,
        after: HeldObject | None,
        end: Body | None,
    ) -> list[Trajectory] | None:
        """The phases as one motion of what touches others where it was taken, or, at `end`, where it is put down."""
        held = phases[0].phases[0].touched if phases[0].phases[0].held else None
        if held is None or before is None:
            return None
        world = self.compiled.world(scene.with_held(None))
        world = with_clearance_at_ends(world, scene.body(held.name), end)
        return merge_phases(world, phases, before, after, self.workspace.hurries)

    def is_accepted(self, scene: Scene, paths: Sequence[WholeBodyPath | Trajectory]) -> bool:
        """Whether MuJoCo finds no penetration on any of the paths."""
        return not self.refusal(scene, paths)

    def refusal(self, scene: Scene, paths: Sequence[WholeBodyPath | Trajectory]) -> str:
        """Penetration that MuJoCo finds on one of the paths, with the names of the bodies, "" for none."""
        world, among = self.compiled.world(scene), signature(scene)
        if among not in self.checkers:
            self.checkers[among] = MujocoCollisionChecker(scene, world)
        self.checkers[among].move_to(scene, world)
        reports = (self.checkers[among].deepest_penetration(path, STEP, TOLERANCE) for path in paths)
        return next((str(report) for report in reports if report.penetration > TOLERANCE), "")


def _end_state(motion: PickPlaceMotion, trajectory: Trajectory) -> RobotState:
    return RobotState(motion.retreat.end_base, motion.retreat.end, float(trajectory.finger_position[-1]))


def _with_trajectory(action: BoundAction, trajectory: Trajectory) -> BoundAction:
    """The action with another trajectory. The robot in its scene starts where the trajectory begins."""
    state = RobotState(trajectory.base[0], trajectory.q[0], float(trajectory.finger_position[0]))
    return replace(action, trajectory=trajectory, scene=action.scene.with_state(state))
