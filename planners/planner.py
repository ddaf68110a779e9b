"""Planning for a whole task: the entry point of the package."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from assets.robots import FETCH, RobotSpec, robot as find_robot
from planners.cause import Cause
from planners.checking import hindrance, not_at_rest
from planners.clearing.goal_bound import LowerBound, must_move
from planners.clearing.lower_bound import MAX_EXPANSIONS, ClearanceFloor, self_clearable_sets
from planners.clock import NO_DEADLINE, Deadline
from planners.collision.ground_map import GroundMap
from planners.collision.world import CompiledScenes
from planners.goals import Goal, holding
from planners.grasping.families import Grasps, find_grasp_set
from planners.motion.base import BaseRoadmap
from planners.motion.path import on_base
from planners.motion.tcp_following import TcpFollower
from planners.opening.through import Asked, lower_bound_through, solve_through
from planners.placing.surfaces import Supports
from planners.problem import Problem, goal_in, not_sunk, robot_of
from planners.scene import Scene
from planners.scene.findings import Reason
from planners.strategies import STRATEGIES, Strategy, find_strategy
from planners.symbolic.engines import task_planner
from planners.symbolic.problem import TaskPlanner
from planners.tamp.attempts import best_of_attempts
from planners.tamp.solution import Infeasible, Solution
from planners.warming import warm_once
from planners.workspace import Workspace, check_arms


def solve(
    scene: Scene,
    goal: str | Goal,
    strategy: str | Strategy = "lookahead",
    rng: np.random.Generator | int | None = None,
    time_limit: float | None = None,
    *,
    grasps: Grasps = "all",
    supports: Supports = None,
    hold_aside: bool = False,
) -> Solution | Infeasible:
    """Plan for a goal: to take an object out of the clutter, or to put objects where they are wanted.

    Args:
        scene: the world, the robot in its home configuration; an object may be held.
        goal: name of the object to take, a `planners.goals.Goal`, or its PDDL text.
        strategy: "lookahead" (default), "ngr" (Lee & Kim 2019), "dogar", "srivastava", or a `Strategy`.
        rng: a generator for sampling, or a seed; the same state gives the same plan. Seed 0 if not given.
        time_limit: [s] of wall time, None for none. It ends a solve: with the best plan of the attempts made by then,
            else with the cause "time limit". Loading the kernels in a new process counts, compiling them on the first
            run of a machine does not; see `warmup`.
        grasps: the grasp set to choose from: "side" (level; the paper's experiment), "tilted", "top", "all", or a tuple
            of `GraspFamily` and `AntipodalFamily`. Refusals hold for this grasp set, and name it.
        supports: where objects may be put: names of the scene's supports, "all" that it declares, or None: with side
            grasps the first alone, R_plane of the paper, with other grasp sets all. What the goal names is allowed.
        hold_aside: of a robot that acts with several arms: whether one may hold an obstacle while another one takes the
            target. The paper forbids it: there every obstacle is put down.

    Returns:
        The plan with all its motions, or the cause why there is none. Objects of the goal that the robot cannot carry,
        or that are in the air, are refused; `planners.check` says what is odd about all objects.

    Raises:
        UnknownObject: no object of that name.
        GoalError: the goal means nothing in the scene, or contradicts itself.
        UnknownStrategy: neither the name of a strategy nor a `Strategy`.
        TimeLimitError: the time limit is not a number, or is negative.
        UnknownGraspSet: neither the name of a grasp set nor families.
        SceneError: not a `Scene`; objects overlap, or the robot is inside a static obstacle.
        UnknownSupport: the scene declares no support of a name.
        ArmsError: `hold_aside` with a robot that acts with one arm.
    """
    planner = Planner(robot_of(scene), grasps=grasps, supports=supports, hold_aside=hold_aside)
    wanted, chosen, _ = goal_in(scene, goal), find_strategy(strategy), Deadline.after(time_limit)
    taken = must_move(scene, wanted)
    if (found := hindrance(scene, taken)) is not None:
        cause, findings = found
        detail, objects = "; ".join(map(str, findings)), tuple(dict.fromkeys(one.object for one in findings))
        return Infeasible(cause, detail, objects, target=wanted.target, strategy=chosen, goal=wanted)
    return _with_true_cause(scene, taken, planner.solve(scene, wanted, strategy, rng, time_limit))


def _with_true_cause(scene: Scene, taken: tuple[str, ...], found: Solution | Infeasible) -> Solution | Infeasible:
    """The same result, unless it is about objects that are not at rest: a plan for what falls cannot be executed, and
    what is sunk into furniture is refused for that."""
    if isinstance(found, Solution):
        if not (falls := [one for one in not_at_rest(scene, taken) if one.reason is Reason.FLOATING]):
            return found
        detail, objects = "; ".join(map(str, falls)), tuple(one.object for one in falls)
        return Infeasible(
            Cause.NOT_AT_REST,
            detail,
            objects,
            stats=found.stats,
            target=found.target,
            strategy=found.strategy,
            goal=found.goal,
        )
    odd = () if found.cause is Cause.TIME_LIMIT else not_at_rest(scene, found.objects or taken)
    if not odd:
        return found
    return replace(
        found, cause=Cause.NOT_AT_REST, detail=f"{'; '.join(map(str, odd))}; so: {found.cause}, {found.detail}"
    )


def lower_bound(scene: Scene, goal: str | Goal, expansions: int = MAX_EXPANSIONS, *, grasps: str = "all") -> LowerBound:
    """The fewest picks of any plan for a goal, for one grasp set, what must be put aside and picked again among them.

    It holds for the grasps of that set, and for the base poses and arm configurations that all strategies choose from.

    Args:
        scene: as for `solve`.
        goal: as for `solve`.
        expansions: search nodes after which the proof is given up.
        grasps: as for `solve`.

    Raises:
        UnknownObject: no object of that name.
        GoalError: the goal means nothing in the scene, or contradicts itself.
        UnknownGraspSet: no grasp set of that name.
    """
    return Planner(robot_of(scene), grasps=grasps).lower_bound(scene, goal, expansions)


def clearance_floor(
    scene: Scene, target: str, expansions: int = MAX_EXPANSIONS, *, grasps: Grasps = "all"
) -> ClearanceFloor:
    """The exact minimum number of objects any plan must clear before it can take `target`, for one grasp set.

    Exact for the grasps of that set, and for the base poses and arm configurations that all strategies choose from, and
    for every path to them: only what the final grasp configuration hits is counted. Under a shelf the base drives
    straight in and out, and what is in the way of that counts too.

    Args:
        scene: as for `solve`.
        target: name of the object wanted.
        expansions: search nodes after which the proof is given up.
        grasps: as for `solve`.

    Raises:
        UnknownObject: no object of that name.
        UnknownGraspSet: neither the name of a grasp set nor families.
    """
    return Planner(robot_of(scene), grasps=grasps).clearance_floor(scene, target, expansions)


def warmup(robot: str | RobotSpec = FETCH) -> None:
    """Load or compile every kernel that a solve uses, and load or build the robot's reachability map.

    `solve`, `clearance_floor` and the expert do this themselves. Once done in a process it takes microseconds. The
    first run on a machine compiles for about a minute and logs a warning that says so; as information, the logger
    "planners.warming" says which kernel is compiled.
    """
    Planner(find_robot(robot)).warmup()


@dataclass(frozen=True)
class Planner:
    """A robot, a task planner, and choices that hold for every solve.

    Attributes:
        robot: which one; a name, such as "fetch", is replaced by the robot of that name.
        engine: name of the task planner (see `planners.symbolic.engines`), or any object with the `TaskPlanner`
            protocol; None for the default.
        follower: model of how the joints follow, for an end-effector-controlled robot; None for joint control.
        grasps: the grasp set that plans and minimum numbers of clearances are made of: "side" (level, the paper's),
            "tilted", "top" or "all" (default), or a tuple of families, as for `solve`.
        supports: where objects may be put, as for `solve`.
        canonical: make plans to learn from: in similar scenes the same contacts, chosen without random numbers. Every
            phase of a motion ends at rest; see `planners.grasping.candidates` and `planners.placing.placements`.
        hold_aside: whether one arm may hold an obstacle while another one takes the target, as for `solve`.
        saves_time: whether strategies that plan ahead choose grasps that take less time, with less driving, and, of
            robots that act with one arm, releases at which the gripper is turned least; None: if the robot acts with
            several arms.

    Raises:
        UnknownRobot: no robot of that name; the message lists the valid ones.
        UnknownGraspSet: neither the name of a grasp set nor families; the message lists the valid names.
        UnknownEngineError: `engine` is neither; the message lists the names and says what an object must have.
        MissingEngineError: the task planner is not installed.
        ArmsError: `hold_aside`, or several arms that act, together with what they cannot be combined with.
    """

    robot: RobotSpec
    engine: str | TaskPlanner | None = None
    follower: TcpFollower | None = None
    grasps: Grasps = "all"
    supports: Supports = None
    canonical: bool = False
    hold_aside: bool = False
    saves_time: bool | None = None
    _task_planner: TaskPlanner = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "robot", find_robot(self.robot))
        families = find_grasp_set(self.grasps)
        if not isinstance(self.grasps, str):
            object.__setattr__(self, "grasps", families)
        check_arms(self.robot, self.hold_aside, self.follower is not None, self.canonical)
        object.__setattr__(self, "_task_planner", task_planner(self.engine))

    def solve(
        self,
        scene: Scene,
        goal: str | Goal,
        strategy: str | Strategy = "lookahead",
        rng: np.random.Generator | int | None = None,
        time_limit: float | None = None,
        start: Scene | None = None,
    ) -> Solution | Infeasible:
        """Plan for a goal; see the function `solve`.

        `start` is the scene from which the goal counts, as for `Goal.holds`, if something has happened since.
        """
        if start is not None:
            robot_of(start)
        wanted, chosen = goal_in(scene, goal, start), find_strategy(strategy)
        deadline = warm_once(self.robot, self.follower, self._exercise, Deadline.after(time_limit))
        if deadline.is_over:
            detail = "the time was up before planning began; planners.warmup() loads what a solve needs beforehand"
            return Infeasible(Cause.TIME_LIMIT, detail, target=wanted.target, strategy=chosen, goal=wanted)
        drawn = np.random.default_rng(rng or 0)
        if scene.openings:
            return solve_through(self._asked(chosen, drawn, deadline), scene, wanted, start)
        problem = self._problem(scene, wanted, start)
        return best_of_attempts(problem, chosen, self._task_planner, drawn, deadline)

    def _problem(self, scene: Scene, wanted: Goal, start: Scene | None = None) -> Problem:
        """The problem of a goal that means something in a scene."""
        return Problem.of(scene, wanted, self.workspace(scene), start=start, hold_aside=self.hold_aside)

    def _asked(self, strategy: Strategy, rng: np.random.Generator, deadline: Deadline) -> Asked:
        """The planner as it is asked for the parts of a plan."""
        return Asked(
            self._problem,
            lambda problem: best_of_attempts(problem, strategy, self._task_planner, rng, deadline),
            deadline,
        )

    def problem(self, scene: Scene, goal: str | Goal, start: Scene | None = None) -> Problem:
        """The problem of a goal in a scene, to be kept: for its bound, for solves, and for the scenes that follow.

        The arguments and errors are those of `solve`.
        """
        wanted = goal_in(scene, goal, start)
        self.warmup()
        return self._problem(scene, wanted, start)

    def solve_problem(
        self,
        problem: Problem,
        strategy: str | Strategy = "lookahead",
        rng: np.random.Generator | int | None = None,
        time_limit: float | None = None,
    ) -> Solution | Infeasible:
        """Plan for a problem that is kept; see the function `solve`."""
        chosen, drawn, deadline = find_strategy(strategy), np.random.default_rng(rng or 0), Deadline.after(time_limit)
        if problem.scene.openings:
            return solve_through(self._asked(chosen, drawn, deadline), problem.scene, problem.goal, problem.start)
        return best_of_attempts(problem, chosen, self._task_planner, drawn, deadline)

    def lower_bound(self, scene: Scene, goal: str | Goal, expansions: int = MAX_EXPANSIONS) -> LowerBound:
        """The fewest picks for a goal; see the function `lower_bound`."""
        wanted, scene = goal_in(scene, goal), not_sunk(scene)
        self.warmup()
        if scene.openings:
            return lower_bound_through(
                self._asked(STRATEGIES["lookahead"], np.random.default_rng(0), NO_DEADLINE), scene, wanted
            )
        workspace = Workspace.of(self.robot, scene, grasps=self.grasps)
        return Problem(scene, wanted, scene, workspace, self.hold_aside).lower_bound(expansions)

    def clearance_floor(self, scene: Scene, target: str, expansions: int = MAX_EXPANSIONS) -> ClearanceFloor:
        """The minimum number of clearances; see the function `clearance_floor`."""
        robot_of(scene)
        scene.index(target)
        scene = not_sunk(scene)
        self.warmup()
        workspace = Workspace.of(self.robot, scene, grasps=self.grasps)
        if target in scene.held_names:
            return ClearanceFloor(0, (), True, 0, grasps=workspace.catalogue)
        blockers = partial(workspace.grasps().blockers, scene)
        found = next(self_clearable_sets(blockers, target, scene.names, expansions=expansions))
        is_too_wide = found.cause == Cause.UNREACHABLE and workspace.too_wide(scene, target)
        return replace(found, cause=Cause.TOO_WIDE if is_too_wide else found.cause, grasps=workspace.catalogue)

    def warmup(self) -> None:
        """Load or compile everything that a solve uses; see the function `warmup`."""
        warm_once(self.robot, self.follower, self._exercise)

    def workspace(self, scene: Scene) -> Workspace:
        """The workspace that a solve compiles once for the static obstacles of a scene; raises `UnknownSupport`."""
        return Workspace.of(
            self.robot,
            scene,
            grasps=self.grasps,
            # With side grasps the first support alone, R_plane of the paper; with other grasp sets all.
            supports="all" if self.supports is None and self.grasps != "side" else self.supports,
            canonical=self.canonical,
            follower=self.follower,
            saves_time=self.saves_time,
        )

    def _exercise(self, scene: Scene, target: str) -> None:
        """Run what a solve runs; the task planner may be the user's own, so another one takes its place."""
        planner = replace(self, engine="astar", grasps="side", supports=None)
        for name in ("lookahead", "ngr"):
            problem = Problem.of(scene, holding(target), planner.workspace(scene))
            rng = np.random.default_rng(0)
            best_of_attempts(problem, STRATEGIES[name], planner._task_planner, rng, NO_DEADLINE)
        # A drive that no solve in an open scene needs.
        X, world = on_base([scene.state.base, scene.state.base - 0.3], scene.state.q), CompiledScenes().world(scene)
        BaseRoadmap(GroundMap(scene)).search(world, X, 0.0, None, np.random.default_rng(0))
