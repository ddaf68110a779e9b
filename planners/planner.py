"""Planning for a whole task: the entry point of the package."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from assets.robots import FETCH, RobotSpec
from irm.chain import ArmChain
from planners.arms import check_arms, one_or_all
from planners.cause import Cause
from planners.clearing.minimum_clearances import ClearanceFloor, FloorLimits
from planners.clearing.minimum_clearances import clearance_floor as floor_of_options
from planners.clock import NO_DEADLINE, Deadline, cpu_seconds
from planners.collision.compiled_scenes import CompiledScenes
from planners.collision.validation import validate
from planners.grasping.arms import ArmCandidates
from planners.grasping.base_placement import MapPlacer, inverse_map
from planners.grasping.candidates import GraspCandidates, SamplingConfig
from planners.grasping.canonical import CanonicalGrasps
from planners.grasping.families import find_grasp_set
from planners.motion.tcp_following import TcpFollower
from planners.placing.arms import ArmPlacements
from planners.placing.canonical import CanonicalPlacements
from planners.placing.placements import PlacementSearch
from planners.placing.surfaces import Supports, find_supports
from planners.scene import Scene
from planners.strategies import STRATEGIES, Strategy, find_strategy
from planners.symbolic.engines import task_planner
from planners.symbolic.problem import TaskPlanner
from planners.tamp.algorithm1 import task_and_motion_plan
from planners.tamp.attempts import best_outcome, is_final
from planners.tamp.motion_layer import MotionLayer
from planners.tamp.solution import Infeasible, Solution
from planners.tamp.state import Search
from planners.warming import warm_once

__all__ = ["Planner", "clearance_floor", "map_placer", "solve", "warmup"]

_BASES, _BASES_NEAR_HOME = 3, 8
"""Base poses tried for each gripper pose; more where only one configuration counts at each."""
_GRASPS, _PLACEMENTS = (GraspCandidates, CanonicalGrasps), (PlacementSearch, CanonicalPlacements)
"""Where contacts come from: in ordinary plans, in canonical ones."""


def solve(
    scene: Scene,
    target: str,
    strategy: str | Strategy = "lookahead",
    rng: np.random.Generator | None = None,
    time_limit: float | None = None,
    *,
    grasps: str = "all",
    supports: Supports = None,
    hold_aside: bool = False,
) -> Solution | Infeasible:
    """Plan to take `target` out of the clutter.

    Args:
        scene: the world, the robot in its home configuration; an object may be held.
        target: name of the object wanted.
        strategy: "lookahead" (default), "ngr" (Lee & Kim 2019), "dogar", "srivastava", or a `Strategy`.
        rng: for sampling; the same generator state gives the same plan. Seed 0 if not given.
        time_limit: [s] of wall time, None for none. It ends a solve: with the best plan of the attempts made by then,
            else with the cause "time limit". Loading the kernels in a new process counts, compiling them on the first
            run of a machine does not; see `warmup`.
        grasps: name of the grasp set to choose from: "side" (level; the paper's experiment), "tilted", "top" or "all".
        supports: where objects may be put: names of the scene's supports, "all" that it declares, or None: with side
            grasps the first alone, R_plane of the paper, with other grasp sets all.
        hold_aside: of a robot that acts with several arms: whether one may hold an obstacle while another one takes the
            target. The paper forbids it: there every obstacle is put down.

    Returns:
        The plan with all its motions, or the cause why there is none.

    Raises:
        UnknownObject: no object of that name.
        UnknownStrategy: neither the name of a strategy nor a `Strategy`.
        TimeLimitError: the time limit is not a number, or is negative.
        UnknownGraspSet: no grasp set of that name.
        SceneError: objects overlap, or the robot is inside a static obstacle.
        UnknownSupport: the scene declares no support of a name.
        ArmsError: `hold_aside` with a robot that acts with one arm.
    """
    planner = Planner(scene.robot, grasps=grasps, supports=supports, hold_aside=hold_aside)
    return planner.solve(scene, target, strategy, rng, time_limit)


def clearance_floor(
    scene: Scene, target: str, limits: FloorLimits | None = None, *, grasps: str = "all"
) -> ClearanceFloor:
    """The exact minimum number of objects any plan must clear before it can take `target`, for one grasp set.

    Exact for the grasps of that set, and for the base poses and arm configurations that all strategies choose from, and
    for every path to them: only what the final grasp configuration hits is counted. Under a board the base drives
    straight in and out, and what is in the way of that counts too.

    Args:
        scene: as for `solve`.
        target: name of the object wanted.
        limits: when to give up the proof.
        grasps: as for `solve`.

    Raises:
        UnknownObject: no object of that name.
        UnknownGraspSet: no grasp set of that name.
    """
    return Planner(scene.robot, grasps=grasps).clearance_floor(scene, target, limits)


def warmup(robot: RobotSpec = FETCH) -> None:
    """Load or compile every kernel that a solve uses, and load or build the robot's reachability map.

    `solve`, `clearance_floor` and the expert do this themselves. Once done in a process it takes microseconds. The
    first run on a machine compiles for about a minute and logs a warning that says so; as information, the logger
    "planners.warming" says which kernel is compiled.
    """
    Planner(robot).warmup()


def map_placer(scene: Scene, per_gripper_pose: int = _BASES) -> MapPlacer:
    """Base poses for gripper poses in this scene, from the robot's cached reachability map."""
    return MapPlacer.of_scene(inverse_map(scene.robot), scene, per_gripper_pose)


@dataclass(frozen=True)
class Planner:
    """A robot's maps and a task planner, kept between solves.

    Attributes:
        robot: which one.
        engine: name of the task planner (see `planners.symbolic.engines`), or any object with the `TaskPlanner`
            protocol; None for the default.
        follower: model of how the joints follow, for a robot that is told TCP poses; None for one told joint targets.
        grasps: name of the grasp set that plans and minimum numbers of clearances are made of: "side" (level, the
            paper's), "tilted", "top" or "all" (default).
        supports: where objects may be put, as for `solve`.
        canonical: make plans to learn from: in similar scenes the same contacts, chosen without random numbers. Every
            phase of a motion ends at rest; see `planners.grasping.canonical` and `planners.placing.canonical`.
        hold_aside: whether one arm may hold an obstacle while another one takes the target, as for `solve`.
        saves_time: whether strategies that plan ahead choose grasps that take less time, with less driving; None: if
            the robot acts with several arms.

    Raises:
        UnknownGraspSet: no grasp set of that name; the message lists the valid ones.
        UnknownEngineError: `engine` is neither; the message lists the names and says what an object must have.
        MissingEngineError: the task planner is not installed.
        ArmsError: `hold_aside`, or several arms that act, together with what they cannot be combined with.
    """

    robot: RobotSpec
    engine: str | TaskPlanner | None = None
    follower: TcpFollower | None = None
    grasps: str = "all"
    supports: Supports = None
    canonical: bool = False
    hold_aside: bool = False
    saves_time: bool | None = None
    _task_planner: TaskPlanner = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        find_grasp_set(self.grasps)
        check_arms(self.robot, self.hold_aside, self.follower is not None, self.canonical)
        object.__setattr__(self, "_task_planner", task_planner(self.engine))

    def solve(
        self,
        scene: Scene,
        target: str,
        strategy: str | Strategy = "lookahead",
        rng: np.random.Generator | None = None,
        time_limit: float | None = None,
    ) -> Solution | Infeasible:
        """As the function `solve`."""
        scene.index(target)
        chosen = find_strategy(strategy)
        deadline = warm_once(self, self._exercise, Deadline.after(time_limit))
        if deadline.is_over:
            detail = "the time was up before planning began; planners.warmup() loads what a solve needs beforehand"
            return Infeasible(Cause.TIME_LIMIT, detail, target=target, strategy=chosen)
        return self._solve(scene, target, chosen, rng or np.random.default_rng(0), deadline)

    def clearance_floor(self, scene: Scene, target: str, limits: FloorLimits | None = None) -> ClearanceFloor:
        """As the function `clearance_floor`."""
        scene.index(target)
        self.warmup()
        return self._clearance_floor(scene, target, limits)

    def warmup(self) -> None:
        """As the function `warmup`, for this robot and task planner."""
        warm_once(self, self._exercise)

    def _exercise(self, scene: Scene, target: str) -> None:
        """Run what a solve runs; the task planner may be the user's own, so another one takes its place."""
        planner = replace(self, engine="astar", grasps="side", supports=None)
        for name in ("lookahead", "ngr"):
            planner._solve(scene, target, STRATEGIES[name], np.random.default_rng(0), NO_DEADLINE)

    def _solve(
        self, scene: Scene, target: str, strategy: Strategy, rng: np.random.Generator, deadline: Deadline
    ) -> Solution | Infeasible:
        started = cpu_seconds()
        compiled = CompiledScenes()
        validate(compiled.world(scene))
        outcomes: list[Solution | Infeasible] = []
        is_proved = False
        for motion_layer in self._motion_layers(scene, compiled, rng, deadline, strategy.attempts):
            search = Search(target, strategy, self._task_planner, motion_layer, hold_aside=self.hold_aside)
            outcomes.append(task_and_motion_plan(search, scene))
            is_proved = is_final(outcomes[-1], motion_layer)
            if deadline.is_over or is_proved:
                break
        best = best_outcome(outcomes, is_proved, deadline)
        return replace(best, stats=replace(best.stats, total_s=cpu_seconds() - started))

    def _clearance_floor(self, scene: Scene, target: str, limits: FloorLimits | None) -> ClearanceFloor:
        families = find_grasp_set(self.grasps)
        by_arm = {
            scene.robot.arm_name: GraspCandidates(
                map_placer(scene), ArmChain.from_robot(scene.robot), families=families
            )
            for scene in map(scene.using, self.robot.acting_arms)
        }
        candidates = one_or_all(by_arm, ArmCandidates.of)
        return floor_of_options(scene, target, _Blockers(candidates, scene), limits)

    def _motion_layers(
        self, scene: Scene, compiled: CompiledScenes, rng: np.random.Generator, deadline: Deadline, attempts: int
    ) -> Iterator[MotionLayer]:
        """A motion layer for each attempt.

        For a robot that is told TCP poses there is one more, before the others, with configurations near home only.
        """
        supports = self.supports_in(scene)
        any_placers = {arm: self._placer(scene.using(arm)) for arm in self.robot.acting_arms}
        for attempt in range(attempts + (self.follower is not None)):
            near_home = self.follower is not None and attempt == 0
            config, families = SamplingConfig(near_home=near_home), find_grasp_set(self.grasps)
            grasps, placements = {}, {}
            for arm, any_placer in any_placers.items():
                placer = replace(any_placer, per_gripper_pose=_BASES_NEAR_HOME if near_home else _BASES)
                chain = self.chain if arm == self.robot.arm_name else ArmChain.from_robot(self.robot.using(arm))
                grasps[arm] = _GRASPS[self.canonical](placer, chain, config, compiled, families)
                placements[arm] = _PLACEMENTS[self.canonical](placer, chain, near_home=near_home, supports=supports)
            yield MotionLayer(
                one_or_all(grasps, ArmCandidates.of),
                one_or_all(placements, ArmPlacements.of),
                np.random.default_rng(attempt) if self.canonical else rng,
                follower=self.follower,
                deadline=deadline,
                joins_motions=not self.canonical,
                saves_time=self.robot.acts_with_all_arms if self.saves_time is None else self.saves_time,
            )

    def _placer(self, scene: Scene) -> MapPlacer:
        """Base poses for the active arm of a scene."""
        return MapPlacer.of_scene(inverse_map(scene.robot), scene)

    def supports_in(self, scene: Scene) -> tuple[str, ...]:
        """The names of the supports where objects may be put in a scene; raises `UnknownSupport`."""
        return find_supports(scene, self.support_choice)

    @property
    def support_choice(self) -> Supports:
        """`supports`, or what None stands for: the first one with side grasps, all with other grasp sets."""
        if self.supports is not None:
            return self.supports
        return None if self.grasps == "side" else "all"

    @cached_property
    def chain(self) -> ArmChain:
        """The robot's torso and arm."""
        return ArmChain.from_robot(self.robot)


@dataclass(frozen=True)
class _Blockers:
    """The blocker masks of the grasp candidates in one scene."""

    candidates: GraspCandidates
    scene: Scene

    def blockers(self, name: str) -> Sequence[int]:
        """As `BlockerMasks.blockers`."""
        return [option.blockers for option in self.candidates.for_object(self.scene, name)]
