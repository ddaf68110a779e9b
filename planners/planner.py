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
    """Plan for a goal: take an object out of the clutter, or put objects at their goal places.

    Args:
        scene: the scene, with the robot in its home configuration. An object may be held.
        goal: name of the object to take, a `planners.goals.Goal`, or its PDDL text.
        strategy: "lookahead" (default), "ngr" (Lee & Kim 2019), "dogar", "srivastava", or a `Strategy`.
        rng: a generator for sampling, or a seed, 0 by default. The same state gives the same plan.
        time_limit: wall time [s], unlimited by default. At the limit, a solve ends with the best plan of the attempts
            so far, else with the cause "time limit". The limit includes loading the kernels in a new process, but not
            compiling them on the first run of a machine. See `warmup`.
        grasps: the grasp set to choose from: "side" (level, the paper's experiment), "tilted", "top", "all", or a tuple
            of `GraspFamily` and `AntipodalFamily`. Refusals hold for this grasp set and name it.
        supports: supports for objects put aside: names of the scene's supports, "all" that it declares, or None. With
            side grasps, None means the first support only, R_plane of the paper. With other grasp sets, None means all.
            The goal's own places are always allowed.
        hold_aside: whether, for a robot that acts with several arms, one may hold an obstacle while another takes the
            target. The paper forbids it: every obstacle is put down.

    Returns:
        The plan with all its motions, or the cause why no plan was found. A goal is refused if the robot cannot carry
        its objects, or if they are in the air. `planners.check` reports on all objects.

    Raises:
        UnknownObject: no object of that name.
        GoalError: the goal is invalid in the scene, or contradicts itself.
        UnknownStrategy: the strategy is neither a known name nor a `Strategy`.
        TimeLimitError: the time limit is not a number, or is negative.
        UnknownGraspSet: the grasps are neither the name of a grasp set nor families.
        SceneError: the scene is no `Scene`, objects overlap, or the robot is inside a static obstacle.
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
    """Refuse a plan for objects in the air, and name sunk or floating objects as the cause of a refusal.

    A plan for a falling object cannot be executed. An object sunk into furniture is refused for that reason, too.
    """
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
    """Find the lower bound of the picks of any plan for a goal, for one grasp set, with repeated picks included.

    It holds for the grasps of that set, and for a sample of up to 40 base poses for each, with several arm
    configurations. With others a plan can have fewer picks.

    Args:
        scene: as for `solve`.
        goal: as for `solve`.
        expansions: limit of search nodes for the proof.
        grasps: as for `solve`.

    Raises:
        UnknownObject: no object of that name.
        GoalError: the goal is invalid in the scene, or contradicts itself.
        UnknownGraspSet: no grasp set of that name.
    """
    return Planner(robot_of(scene), grasps=grasps).lower_bound(scene, goal, expansions)


def clearance_floor(
    scene: Scene, target: str, expansions: int = MAX_EXPANSIONS, *, grasps: Grasps = "all"
) -> ClearanceFloor:
    """Find the exact minimum number of objects that any plan must clear before it can take `target`, for one grasp set.

    It is exact for the grasps of that set, and for a sample of up to 40 base poses for each, with several arm
    configurations. With others a plan can clear fewer. It holds for every path to them: only
    objects in collision at the final grasp configuration are included. Under a shelf, the base drives straight in and
    out, and objects in the way of this drive are included too.

    Args:
        scene: as for `solve`.
        target: name of the object to take.
        expansions: limit of search nodes for the proof.
        grasps: as for `solve`.

    Raises:
        UnknownObject: no object of that name.
        UnknownGraspSet: the grasps are neither the name of a grasp set nor families.
    """
    return Planner(robot_of(scene), grasps=grasps).clearance_floor(scene, target, expansions)


def warmup(robot: str | RobotSpec = FETCH) -> None:
    """Load or compile every kernel that a solve uses, and load or build the robot's reachability map.

    `solve`, `clearance_floor` and the expert call it themselves. Later calls in the same process take microseconds. The
    first run on a machine compiles for about a minute and logs a warning about it. At level INFO, the logger
    "planners.warming" names each kernel that is compiled.
    """
    Planner(find_robot(robot)).warmup()


@dataclass(frozen=True)
class Planner:
    """A planner for a robot: task planner and options for every solve.

    Attributes:
        robot: the robot. A name, such as "fetch", is replaced by the robot of that name.
        engine: name of the task planner (see `planners.symbolic.engines`), or any object with the `TaskPlanner`
            protocol. None for the default.
        follower: model of how the joints follow, for an end-effector-controlled robot. None for joint control.
        grasps: the grasp set for plans and lower bounds, as for `solve`: "side" (level, the paper's), "tilted", "top",
            "all" (default), or a tuple of families.
        supports: supports for objects put aside, as for `solve`.
        canonical: whether to make plans to learn from. Similar scenes get the same contacts, without random choices.
            Every phase of a motion ends at rest. See `planners.grasping.candidates` and `planners.placing.placements`.
        hold_aside: whether one arm may hold an obstacle while another one takes the target, as for `solve`.
        saves_time: whether strategies that plan ahead prefer quick grasps with less driving. For robots that act with
            one arm, releases at which the gripper is turned least come first too. None: only if the robot acts with
            several arms.

    Raises:
        UnknownRobot: no robot of that name. The message lists the valid names.
        UnknownGraspSet: the grasps are neither the name of a grasp set nor families. The message lists the valid names.
        UnknownEngineError: `engine` is neither a known name nor such an object. The message lists the names and the
            protocol.
        MissingEngineError: the task planner is not installed.
        ArmsError: `hold_aside`, or several acting arms, cannot be combined with the other options.
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
        """Plan for a goal. See the function `solve`.

        `start` is the scene that the goal is measured from, as in `Goal.holds`, if something has moved since.
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
        """Problem of a valid goal in a scene."""
        return Problem.of(scene, wanted, self.workspace(scene), start=start, hold_aside=self.hold_aside)

    def _asked(self, strategy: Strategy, rng: np.random.Generator, deadline: Deadline) -> Asked:
        """The planner as a callback for the parts of a plan."""
        return Asked(
            self._problem,
            lambda problem: best_of_attempts(problem, strategy, self._task_planner, rng, deadline),
            deadline,
        )

    def problem(self, scene: Scene, goal: str | Goal, start: Scene | None = None) -> Problem:
        """Problem of a goal in a scene, to keep for its bound, for solves, and for later scenes.

        Arguments and errors are those of `solve`.
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
        """Plan for a kept problem. See the function `solve`."""
        chosen, drawn, deadline = find_strategy(strategy), np.random.default_rng(rng or 0), Deadline.after(time_limit)
        if problem.scene.openings:
            return solve_through(self._asked(chosen, drawn, deadline), problem.scene, problem.goal, problem.start)
        return best_of_attempts(problem, chosen, self._task_planner, drawn, deadline)

    def lower_bound(self, scene: Scene, goal: str | Goal, expansions: int = MAX_EXPANSIONS) -> LowerBound:
        """Find the lower bound of the picks for a goal. See the function `lower_bound`."""
        wanted, scene = goal_in(scene, goal), not_sunk(scene)
        self.warmup()
        if scene.openings:
            return lower_bound_through(
                self._asked(STRATEGIES["lookahead"], np.random.default_rng(0), NO_DEADLINE), scene, wanted
            )
        workspace = Workspace.of(self.robot, scene, grasps=self.grasps)
        return Problem(scene, wanted, scene, workspace, self.hold_aside).lower_bound(expansions)

    def clearance_floor(self, scene: Scene, target: str, expansions: int = MAX_EXPANSIONS) -> ClearanceFloor:
        """Find the minimum number of clearances. See the function `clearance_floor`."""
        robot_of(scene)
        scene.index(target)
        scene = not_sunk(scene)
        self.warmup()
        workspace = Workspace.of(self.robot, scene, grasps=self.grasps)
        if target in scene.held_names:
            return ClearanceFloor(0, (), True, 0, grasps=workspace.catalogue)
        blockers = partial(workspace.looking_closely().grasps().blockers, scene)
        found = next(self_clearable_sets(blockers, target, scene.names, expansions=expansions))
        is_too_wide = found.cause == Cause.UNREACHABLE and workspace.too_wide(scene, target)
        return replace(found, cause=Cause.TOO_WIDE if is_too_wide else found.cause, grasps=workspace.catalogue)

    def warmup(self) -> None:
        """Load or compile everything that a solve uses. See the function `warmup`."""
        warm_once(self.robot, self.follower, self._exercise)

    def workspace(self, scene: Scene) -> Workspace:
        """Workspace for the static obstacles of a scene, compiled once per solve. Raises `UnknownSupport`."""
        return Workspace.of(
            self.robot,
            scene,
            grasps=self.grasps,
            # With side grasps, only the first support, R_plane of the paper. With other grasp sets, all supports.
            supports="all" if self.supports is None and self.grasps != "side" else self.supports,
            canonical=self.canonical,
            follower=self.follower,
            saves_time=self.saves_time,
        )

    def _exercise(self, scene: Scene, target: str) -> None:
        """Run the code of a solve. The task planner may be the user's own, so A* takes its place."""
        planner = replace(self, engine="astar", grasps="side", supports=None)
        for name in ("lookahead", "ngr"):
            problem = Problem.of(scene, holding(target), planner.workspace(scene))
            rng = np.random.default_rng(0)
            best_of_attempts(problem, STRATEGIES[name], planner._task_planner, rng, NO_DEADLINE)
        # Drive search is not exercised by a solve in an open scene.
        X, world = on_base([scene.state.base, scene.state.base - 0.3], scene.state.q), CompiledScenes().world(scene)
        BaseRoadmap(GroundMap(scene)).search(world, X, 0.0, None, np.random.default_rng(0))
