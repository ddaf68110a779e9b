"""Limits: what decides an answer counts work, the time limit only ends a solve, and nothing compiles inside it."""

from __future__ import annotations

import itertools
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from assets.robots import FETCH
from planners import Cause, Infeasible, NoPlan, Planner, Solution, TaskPlan, solve
from planners.clock import Deadline, TimeLimitError, children_counted, cpu_seconds
from planners.symbolic.astar import AStar
from planners.symbolic.engines import default_engine
from planners.symbolic.problem import TaskProblem
from tests.planners.clearing.test_lower_bound import random_clutter, sets, smallest
from tests.planners.scenes import cylinder, random_scene, table_scene

FREE = table_scene(cylinder("object_00", 0.0, 0.0))


class Recorder:
    """Plans, and remembers the time limits it was given."""

    def __init__(self) -> None:
        self.limits: list[float] = []

    def plan(self, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
        self.limits.append(time_limit)
        return AStar().plan(problem)


class Sleeper:
    """Uses all the time it is given, finds nothing, and remembers how long it slept [s]."""

    def __init__(self) -> None:
        self.slept_s: list[float] = []

    def plan(self, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
        assert not problem.is_solved
        time.sleep(time_limit)
        self.slept_s.append(time_limit)
        return NoPlan("gave up")


@pytest.mark.parametrize("time_limit", [math.nan, -0.1, -math.inf, "3", True, [1.0]])
def test_a_time_limit_that_is_none_is_refused(time_limit: Any) -> None:
    with pytest.raises(TimeLimitError, match="time_limit="):
        solve(FREE, "object_00", time_limit=time_limit)


def test_the_task_planner_is_given_what_remains() -> None:
    engine = Recorder()
    Planner(FETCH, engine=engine).solve(FREE, "object_00", time_limit=5.0)
    assert engine.limits
    assert all(0 < limit <= 5.0 for limit in engine.limits)


@pytest.mark.parametrize("strategy", ["lookahead", "ngr"])
def test_a_slow_task_planner_does_not_hold_up_the_solve(strategy: str) -> None:
    engine = Sleeper()
    planner = Planner(FETCH, engine=engine)
    planner.warmup()
    found = planner.solve(FREE, "object_00", strategy, time_limit=0.5)
    assert engine.slept_s
    assert sum(engine.slept_s) <= 0.5
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.TIME_LIMIT


def test_a_task_planner_that_gives_up_ends_the_solve_and_changes_no_order() -> None:
    """An order that depended on how fast the task planner is would be another plan on another machine."""

    class GivesUpOnce:
        def __init__(self) -> None:
            self.calls = 0

        def plan(self, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
            self.calls += 1
            return NoPlan("gave up") if self.calls == 1 else Recorder().plan(problem, time_limit)

    found = Planner(FETCH, engine=GivesUpOnce()).solve(FREE, "object_00", "lookahead")
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.TIME_LIMIT


def test_a_slow_clock_changes_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a machine on which every step takes ten seconds."""
    problems = [dict(enumerate(random_clutter(np.random.default_rng(seed), 40))) for seed in range(3)]
    expected = [smallest(problem) for problem in problems]
    for name in ("process_time", "perf_counter", "monotonic"):
        monkeypatch.setattr(time, name, itertools.count(0.0, 10.0).__next__)
    assert [smallest(problem) for problem in problems] == expected
    assert any(result.proved and result.count for result in expected)


def test_the_deadline_reaches_the_search_for_the_smallest_sets() -> None:
    asked: list[int] = []

    def options(index: int) -> list[int]:
        asked.append(index)
        return [1 << 59 - index]

    results = list(sets(options, 60, deadline=Deadline.after(0.0)))
    assert [(result.count, result.cause, result.proved) for result in results] == [(None, Cause.TIME_LIMIT, False)]
    assert asked == [0], "options are not asked for once the time is up"


def least_cpu_seconds(call: Callable[[], object]) -> float:
    """[s] Least CPU time of five calls: a garbage collection can take longer than what is measured."""
    spent = []
    for _ in range(5):
        before = cpu_seconds()
        call()
        spent.append(cpu_seconds() - before)
    return min(spent)


def test_a_solve_in_clutter_ends_at_its_time_limit() -> None:
    scene = random_scene(40, 1)
    Planner(FETCH).warmup()
    for name, time_limit in zip(scene.names[:6], (0.0, 0.01, 0.02, 0.05, 0.1, 0.2), strict=True):
        assert least_cpu_seconds(lambda n=name, t=time_limit: solve(scene, n, time_limit=t)) < time_limit + 0.2


class External:
    """A task planner that runs a process of its own for a while, and finds nothing."""

    def plan(self, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
        assert problem.target
        busy = "import time\nwhile time.process_time() < 0.4: pass"
        subprocess.run([sys.executable, "-c", busy], check=True, timeout=time_limit)
        return NoPlan("gave up")


def test_the_clock_asks_for_child_processes_around_engines_that_may_start_some(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is read 50 times a solve, and `os.times` is a system call that can take half a millisecond."""
    asked: list[str] = []
    times = os.times
    monkeypatch.setattr(os, "times", lambda: asked.append("") or times())
    for engine in ("astar", default_engine()):
        assert isinstance(Planner(FETCH, engine=engine).solve(FREE, "object_00"), Solution)
    assert not asked
    assert isinstance(Planner(FETCH, engine=Recorder()).solve(FREE, "object_00"), Solution)
    assert asked, "what a user's engine starts is not known"


def test_cpu_time_of_child_processes_counts_where_it_is_asked_for() -> None:
    busy = [sys.executable, "-c", "import time\nwhile time.process_time() < 0.2: pass"]

    def of_children() -> float:
        return cpu_seconds() - time.process_time()

    before = of_children()
    subprocess.run(busy, check=True)
    assert of_children() - before < 0.1
    with children_counted():
        subprocess.run(busy, check=True)
    assert 0.15 <= of_children() - before < 1.0, "the system counts a child's time in steps of 10 ms or more"


@pytest.mark.parametrize("strategy", ["lookahead", "ngr"])
def test_cpu_time_of_the_task_planner_is_counted_once_processes_included(strategy: str) -> None:
    """A strategy that plans ahead asks for an order while it chooses grasps; that counted as motion planning too."""
    found = Planner(FETCH, engine=External()).solve(FREE, "object_00", strategy)
    assert isinstance(found, Infeasible)
    stats = found.stats
    assert stats.task_planning_s >= 0.35
    assert stats.motion_planning_s + stats.task_planning_s <= stats.total_s + 0.01
