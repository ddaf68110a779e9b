"""What Algorithm 1 works on: its inputs, the state it calls s0, the plan so far, and how it can end."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from planners.cause import Cause
from planners.clearing.lookahead import ClearancePlan
from planners.placing.placements import Placement
from planners.scene import Scene
from planners.strategies import Strategy
from planners.symbolic.problem import GroundAction, SymbolicState, TaskPlanner
from planners.tamp.motion_layer import MotionLayer
from planners.tamp.solution import BoundAction, Infeasible, ReplanRecord, SolveStats

__all__ = ["PlanState", "Refutation", "Search", "TampLimits", "infeasible", "stats"]


@dataclass(frozen=True)
class TampLimits:
    """When to give up: put-downs in one plan, task plans in one plan, seconds for each; time: `MotionLayer.late`."""

    clearances: int = 60
    task_plans: int = 200
    task_planning_s: float = 10.0


@dataclass(frozen=True)
class PlanState:
    """What Algorithm 1 calls s0: the facts, the scene they are about, and what the references stand for."""

    symbols: SymbolicState
    scene: Scene
    clearance_plan: ClearancePlan
    places: Mapping[str, Placement] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True)
class Refutation:
    """An action that motion planning refuted, and what is in its way; nothing if it must be bound anew."""

    action: GroundAction
    blockers: frozenset[str] = frozenset()


@dataclass
class Search:
    """One run of Algorithm 1: what it was given, the plan F so far, and its counts."""

    target: str
    strategy: Strategy
    task_planner: TaskPlanner
    motion_layer: MotionLayer
    limits: TampLimits = field(default_factory=TampLimits)
    plan: list[BoundAction] = field(default_factory=list)
    clearances: list[str] = field(default_factory=list)
    history: list[ReplanRecord] = field(default_factory=list)
    task_plans: int = 0
    task_planning_s: float = 0.0
    motion_planning_s: float = 0.0
    started_cpu: float = field(default_factory=time.process_time)


def infeasible(search: Search, cause: Cause, detail: str, objects: tuple[str, ...]) -> Infeasible:
    """The end of the search without a plan."""
    cleared = tuple(search.clearances)
    return Infeasible(cause, detail, objects, cleared, stats(search), search.target, search.strategy)


def stats(search: Search) -> SolveStats:
    """The counts so far."""
    return SolveStats(
        replans=len(search.history),
        task_plans=search.task_plans,
        task_planning_s=search.task_planning_s,
        motion_planning_s=search.motion_planning_s,
        total_s=time.process_time() - search.started_cpu,
        history=tuple(search.history),
    )
