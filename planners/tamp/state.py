"""State of Algorithm 1: its inputs, the state it calls s0, the plan so far, and how it can end."""

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

MAX_CLEARANCES, MAX_REPLANS, MAX_ASIDE = 60, 200, 6
"""Put-downs in one plan beyond one for each object that the goal places, turns of the loop that ended with a refuted
action, and times that one object is put aside for a goal with places, before a run is given up."""
TASK_PLANNING_S = 10.0
"""[s] of wall time for one call of the task planner; a call that takes longer ends the run."""


@dataclass(frozen=True)
class PlanState:
    """The state that Algorithm 1 calls s0.

    Attributes:
        symbols: the facts.
        scene: the scene they are about.
        clearance_plan: what the grasp references stand for, and where objects are planned to be put.
        put_downs: what the references of put-downs stand for, by location symbol, once the base stands there.
        wanted: the facts `objectAt` that are planned for: the goal's, up to the first object that is to be moved again.
    """

    symbols: SymbolicState
    scene: Scene
    clearance_plan: ClearancePlan
    put_downs: Mapping[str, BoundMotion] = field(default_factory=lambda: MappingProxyType({}))
    wanted: tuple[Atom, ...] = ()


def as_seen(scene: Scene) -> Scene:
    """The same scene, its held objects at the poses at which the grippers hold them."""
    for name in scene.held_names:
        view = scene.holding(name)
        assert view is not None
        assert view.held is not None
        T_world_object = tcp_pose(view.robot, view.state) @ view.held.T_tcp_object
        scene = scene.with_body(scene.body(name).at_pose(T_world_object))
    return scene


def _without_depth(reason: str) -> str:
    """The reason of a refutation without the depths in it."""
    return re.sub(r"[\d.]+ mm", "", reason)


@dataclass(frozen=True)
class Refutation:
    """An action that motion planning refuted.

    Attributes:
        action: which.
        blockers: the objects in its way; none if other grasps must be chosen.
        reason: why there is no motion.
    """

    action: GroundAction
    blockers: frozenset[str] = frozenset()
    reason: str = ""


@dataclass
class Counts:
    """What a run has done so far, and how long it took: calls of the task planner, [s] of CPU time."""

    task_plans: int = 0
    task_planning_s: float = 0.0
    motion_planning_s: float = 0.0
    started_cpu: float = field(default_factory=cpu_seconds)


@dataclass
class Search:
    """One run of Algorithm 1: what it was given, the plan F so far, and what it has learnt.

    Attributes:
        problem, strategy, task_planner, motion_layer: what it was given.
        holds_aside: whether an obstacle may stay in a hand; no longer, once a motion with it was refuted.
        bound: the fewest picks, if moves are planned ahead.
        not_placed: objects for whose places no motion was found.
        plan: the actions bound so far, F of the paper.
        clearances: names of the objects put aside, in order.
        history: the turns of the loop that ended with a refuted action.
        answers: those that the task planner gave.
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
        """What is wanted."""
        return self.problem.goal

    @property
    def target(self) -> str:
        """Name of the object that is to be held if that is the whole goal, else ""."""
        return self.problem.target

    @property
    def is_greedy(self) -> bool:
        """Whether grasps for a target are chosen as the paper does, one after another, without planning ahead."""
        return bool(self.target) and not self.strategy.plans_ahead

    @property
    def is_late(self) -> bool:
        """Whether the time is up."""
        return self.motion_layer.deadline.is_over

    def infeasible(self, cause: Cause, detail: str, objects: tuple[str, ...]) -> Infeasible:
        """The end of the search without a plan.

        A cause that lies in the grasps alone is one only as long as no grasp was refuted and no object moved; it is the
        motions afterwards. Where motions were refuted until nothing or no time was left, the detail says why most were.
        """
        cleared = tuple(self.clearances)
        if cause.lies_in_grasps and (self.motion_layer.has_refuted or self.history or cleared):
            cause = Cause.MOTION
        if cause in (Cause.MOTION, Cause.TIME_LIMIT, Cause.GIVEN_UP):
            reasons = [record.reason for record in self.history if record.reason]
            if cause is Cause.MOTION and set(reasons) == {NO_WAY.reason}:
                cause = Cause.NO_WAY_FOR_BASE
            # The same bodies overlap more or less deeply, by the grasp.
            for kind, count in Counter(map(_without_depth, reasons)).most_common(1):
                reason = next(reason for reason in reasons if _without_depth(reason) == kind)
                detail += f"; {count} of {len(self.history)} refutations: {reason}"
        return Infeasible(cause, detail, objects, cleared, self.stats(), self.target, self.strategy, self.goal)

    def out_of_time(self, scene: Scene | None = None) -> Infeasible:
        """The end of the search at the time limit, or after too many replans or clearances."""
        counts = f"{len(self.history)} replans and {len(self.clearances)} clearances"
        if self.is_late or self.has_given_up:
            return self.infeasible(Cause.TIME_LIMIT, f"the time was up after {counts}", ())
        unmet = () if self.target or scene is None else self.goal.unmet(as_seen(scene), self.problem.start)
        without = f", without {' '.join(str(Goal((fact,))) for fact in unmet)}" if unmet else ""
        why = "" if scene is None else self.why_not_placed(scene, unmet)
        return self.infeasible(Cause.GIVEN_UP, f"given up after {counts}{without}{why}", ())

    def kept_out(self, scene: Scene) -> tuple[str, ...]:
        """Names of objects for which no hand has room in the container into which the goal wants them."""
        candidates = self.motion_layer.candidates
        unmet = self.goal.unmet(as_seen(scene), self.problem.start)
        facts = [fact for fact in self.goal.placed if any(getattr(one, "object", "") == fact.object for one in unmet)]
        return tuple(fact.object for fact in facts if never_fits(candidates, scene, fact.object, place_of(scene, fact)))

    def why_not_placed(self, scene: Scene, facts: Iterable[Fact]) -> str:
        """Why objects cannot be let go where facts of the goal want them, in words that are added; "" if they can."""
        found: list[str] = []
        for fact in (placed_fact(self.goal, getattr(one, "object", "")) for one in facts):
            if fact is not None:
                place = place_of(scene, fact)
                why = why_not_put(self.motion_layer.candidates, scene, fact.object, place)
                found += [why] if why and why not in found else []
        return "".join(f"; {why}" for why in found)

    def stats(self) -> SolveStats:
        """The counts so far."""
        return SolveStats(
            replans=len(self.history),
            task_plans=self.counts.task_plans,
            task_planning_s=self.counts.task_planning_s,
            motion_planning_s=self.counts.motion_planning_s,
            total_s=cpu_seconds() - self.counts.started_cpu,
            unusable=self.motion_layer.candidates.unusable,
            history=tuple(self.history),
        )
