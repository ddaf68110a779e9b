"""State of Algorithm 1: its inputs, its state s0, the plan so far, and its ends."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from planners.cause import Cause
from planners.clearing.clearance_plan import ClearancePlan
from planners.clearing.goal_bound import LowerBound
from planners.clearing.moves import NotPlaced
from planners.clock import cpu_seconds
from planners.goals import Fact, Goal
from planners.motion.arm import tcp_pose
from planners.motion.path import NO_WAY
from planners.placing.goal_places import place_of, placed_fact
from planners.placing.why_not import never_fits, why_not_put
from planners.problem import Problem
from planners.scene import Scene
from planners.strategies import Strategy
from planners.symbolic.problem import Atom, GroundAction, NoPlan, SymbolicState, TaskPlan, TaskPlanner, TaskProblem
from planners.tamp.motion_layer import BoundMotion, MotionLayer
from planners.tamp.solution import BoundAction, Infeasible, ReplanRecord, SolveStats

MAX_CLEARANCES = 60
"""Put-downs in one plan, in addition to one for each object that the goal places, after which a run is given up."""
MAX_REPLANS = 200
"""Turns of the loop that end with a refuted action, after which a run is given up."""
MAX_ASIDE = 6
"""Times that one object is put aside for a goal with places, after which a run is given up."""
TASK_PLANNING_S = 10.0
"""Wall time [s] for one call of the task planner. A longer call ends the run."""


@dataclass(frozen=True)
class PlanState:
    """State s0 of Algorithm 1.

    Attributes:
        symbols: the facts.
        scene: the scene that the facts describe.
        clearance_plan: the grasps that the grasp references stand for, and the planned placements.
        put_downs: the motions that put-down references stand for, by location symbol, once the base stands there.
        wanted: the facts `objectAt` to plan for. They are the goal's, up to the first object that must move again.
    """

    symbols: SymbolicState
    scene: Scene
    clearance_plan: ClearancePlan
    put_downs: Mapping[str, BoundMotion] = field(default_factory=lambda: MappingProxyType({}))
    wanted: tuple[Atom, ...] = ()


def as_seen(scene: Scene) -> Scene:
    """The same scene with held objects at their poses in the grippers."""
    for name in scene.held_names:
        view = scene.holding(name)
        assert view is not None
        assert view.held is not None
        T_world_object = tcp_pose(view.robot, view.state) @ view.held.T_tcp_object
        scene = scene.with_body(scene.body(name).at_pose(T_world_object))
    return scene


def _without_depth(reason: str) -> str:
    """Text of a refutation without its depths in mm."""
    return re.sub(r"[\d.]+ mm", "", reason)


@dataclass(frozen=True)
class Refutation:
    """An action that motion planning refuted.

    Attributes:
        action: the refuted action.
        blockers: the objects in its way. Empty if other grasps must be chosen.
        reason: why no motion was found.
    """

    action: GroundAction
    blockers: frozenset[str] = frozenset()
    reason: str = ""


@dataclass
class Counts:
    """Progress of a run: calls of the task planner, and CPU times [s]."""

    task_plans: int = 0
    task_planning_s: float = 0.0
    motion_planning_s: float = 0.0
    started_cpu: float = field(default_factory=cpu_seconds)


@dataclass
class Search:
    """One run of Algorithm 1: its inputs, the plan F so far, and its knowledge.

    Attributes:
        problem, strategy, task_planner, motion_layer: the inputs.
        holds_aside: whether an obstacle may stay in a hand. False once a motion with such an obstacle was refuted.
        bound: lower bound of the picks, if moves are planned ahead.
        not_placed: objects for whose goal places no motion was found.
        plan: the actions bound so far, F of the paper.
        clearances: names of the objects put aside, in order.
        history: the turns of the loop that ended with a refuted action.
        answers: answers of the task planner, by problem.
        has_given_up: whether a call of the task planner reached its time limit.
        counts: calls and times.
    """

    problem: Problem
    strategy: Strategy
    task_planner: TaskPlanner
    motion_layer: MotionLayer
    holds_aside: bool = field(init=False)
    bound: LowerBound | None = None
    not_placed: NotPlaced = field(init=False)
    plan: list[BoundAction] = field(default_factory=list)
    clearances: list[str] = field(default_factory=list)
    history: list[ReplanRecord] = field(default_factory=list)
    answers: dict[TaskProblem, TaskPlan | NoPlan] = field(default_factory=dict)
    has_given_up: bool = False
    counts: Counts = field(default_factory=Counts)

    def __post_init__(self) -> None:
        self.holds_aside, self.not_placed = self.problem.hold_aside, self.motion_layer.not_placed

    @property
    def goal(self) -> Goal:
        """Goal of the problem."""
        return self.problem.goal

    @property
    def target(self) -> str:
        """Name of the object to hold if that is the whole goal, else ""."""
        return self.problem.target

    @property
    def is_greedy(self) -> bool:
        """Whether grasps for a target are chosen one after another without planning ahead, as in the paper."""
        return bool(self.target) and not self.strategy.plans_ahead

    @property
    def is_late(self) -> bool:
        """Whether the deadline is over."""
        return self.motion_layer.deadline.is_over

    def infeasible(self, cause: Cause, detail: str, objects: tuple[str, ...]) -> Infeasible:
        """End the search without a plan.

        A cause that lies in the grasps alone becomes "motion" once a grasp was refuted or an object moved. If refuted
        motions used up the choices or the time, the detail gives the most frequent reason.
        """
        cleared = tuple(self.clearances)
        if cause.lies_in_grasps and (self.motion_layer.has_refuted or self.history or cleared):
            cause = Cause.MOTION
        if cause in (Cause.MOTION, Cause.TIME_LIMIT, Cause.GIVEN_UP):
            reasons = [record.reason for record in self.history if record.reason]
            if cause is Cause.MOTION and set(reasons) == {NO_WAY.reason}:
                cause = Cause.NO_WAY_FOR_BASE
            # The penetration depth depends on the grasp, so the same two bodies count as one reason at any depth.
            if reasons:
                [(kind, count)] = Counter(map(_without_depth, reasons)).most_common(1)
                reason = next(reason for reason in reasons if _without_depth(reason) == kind)
                detail += f"; {count} of {len(self.history)} refutations: {reason}"
        return Infeasible(cause, detail, objects, cleared, self.stats(), self.target, self.strategy, self.goal)

    def out_of_time(self, scene: Scene | None = None) -> Infeasible:
        """End the search at the time limit, or after too many replans or clearances."""
        counts = f"{len(self.history)} replans and {len(self.clearances)} clearances"
        if self.is_late or self.has_given_up:
            return self.infeasible(Cause.TIME_LIMIT, f"the time was up after {counts}", ())
        unmet = () if self.target or scene is None else self.goal.unmet(as_seen(scene), self.problem.start)
        without = f", without {' '.join(str(Goal((fact,))) for fact in unmet)}" if unmet else ""
        why = "" if scene is None else self.why_not_placed(scene, unmet)
        return self.infeasible(Cause.GIVEN_UP, f"given up after {counts}{without}{why}", ())

    def kept_out(self, scene: Scene) -> tuple[str, ...]:
        """Names of objects that no gripper can release inside the container where the goal wants them."""
        candidates = self.motion_layer.candidates
        unmet = self.goal.unmet(as_seen(scene), self.problem.start)
        facts = [fact for fact in self.goal.placed if any(getattr(one, "object", "") == fact.object for one in unmet)]
        return tuple(fact.object for fact in facts if never_fits(candidates, scene, fact.object, place_of(scene, fact)))

    def why_not_placed(self, scene: Scene, facts: Iterable[Fact]) -> str:
        """Reasons why objects cannot be released where the goal wants them, as text to append, "" for none."""
        found: list[str] = []
        for one in facts:
            fact = placed_fact(self.goal, getattr(one, "object", ""))
            if fact is None:
                continue
            why = why_not_put(self.motion_layer.candidates, scene, fact.object, place_of(scene, fact))
            if why and why not in found:
                found.append(why)
        return "".join(f"; {why}" for why in found)

    def stats(self) -> SolveStats:
        """Counts and times so far."""
        return SolveStats(
            replans=len(self.history),
            task_plans=self.counts.task_plans,
            task_planning_s=self.counts.task_planning_s,
            motion_planning_s=self.counts.motion_planning_s,
            total_s=cpu_seconds() - self.counts.started_cpu,
            unusable=self.motion_layer.candidates.unusable,
            history=tuple(self.history),
        )
