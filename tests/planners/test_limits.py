"""Limits: what decides an answer counts work, the time limit only ends a solve, and nothing compiles inside it."""

from __future__ import annotations

import itertools
import logging
import math
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core import event

from assets.robots import FETCH
from planners import Cause, Infeasible, NoPlan, Planner, Solution, TaskPlan, solve, warming
from planners.clearing.minimum_clearances import minimum_clearances, self_clearable_sets
from planners.clock import Deadline, TimeLimitError, cpu_seconds
from planners.motion.arm import BlockedBy, NoPath
from planners.symbolic.astar import shortest_plan
from planners.symbolic.engines import FastDownward
from planners.symbolic.problem import TaskProblem
from planners.symbolic.transitions import obstruction_problem
from planners.tamp import motion_layer
from planners.tamp.attempts import best_outcome
from tests.planners.clearing.test_minimum_clearances import random_clutter
from tests.planners.scenes import cylinder, random_scene, table_scene

FREE = table_scene(cylinder("object_00", 0.0, 0.0))


class Recorder:
    """Plans, and remembers the time limits it was given."""

    def __init__(self) -> None:
        self.limits: list[float] = []

    def plan(self, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
        self.limits.append(time_limit)
        actions = shortest_plan(problem)
        return NoPlan("unsolvable") if actions is None else TaskPlan(actions)


class Sleeper:
    """Uses all the time it is given, and finds nothing."""

    def plan(self, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
        assert not problem.is_solved
        time.sleep(time_limit)
        return NoPlan("gave up")


@pytest.mark.parametrize("time_limit", [math.nan, -0.1, -math.inf, "3", True, [1.0]])
def test_a_time_limit_that_is_none_is_refused(time_limit: Any) -> None:
    with pytest.raises(TimeLimitError, match="time_limit="):
        solve(FREE, "object_00", time_limit=time_limit)


@pytest.mark.parametrize("time_limit", [None, math.inf, 60, np.float64(60.0)])
def test_time_limits_that_are_valid(time_limit: Any) -> None:
    assert isinstance(solve(FREE, "object_00", time_limit=time_limit), Solution)


def test_the_task_planner_is_given_what_remains() -> None:
    engine = Recorder()
    Planner(FETCH, engine=engine).solve(FREE, "object_00", time_limit=5.0)
    assert engine.limits
    assert all(0 < limit <= 5.0 for limit in engine.limits)


@pytest.mark.parametrize("strategy", ["lookahead", "ngr"])
def test_a_slow_task_planner_does_not_hold_up_the_solve(strategy: str) -> None:
    planner = Planner(FETCH, engine=Sleeper())
    planner.warmup()
    before = time.monotonic()
    found = planner.solve(FREE, "object_00", strategy, time_limit=0.5)
    assert 0.4 < time.monotonic() - before < 0.7
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
    problems = [random_clutter(np.random.default_rng(seed), 40).__getitem__ for seed in range(3)]
    expected = [minimum_clearances(problem, 0) for problem in problems]
    for name in ("process_time", "perf_counter", "monotonic"):
        monkeypatch.setattr(time, name, itertools.count(0.0, 10.0).__next__)
    assert [minimum_clearances(problem, 0) for problem in problems] == expected
    assert any(result.proved and result.count for result in expected)


def test_the_deadline_reaches_the_search_for_the_smallest_sets() -> None:
    asked: list[int] = []

    def options(index: int) -> list[int]:
        asked.append(index)
        return [1 << 59 - index]

    results = list(self_clearable_sets(options, 0, deadline=Deadline.after(0.0)))
    assert [(result.count, result.cause, result.proved) for result in results] == [(None, Cause.TIME_LIMIT, False)]
    assert asked == [0], "options are not asked for once the time is up"


def test_a_solve_in_clutter_ends_at_its_time_limit() -> None:
    scene = random_scene(40, 1)
    Planner(FETCH).warmup()
    for name, time_limit in zip(scene.names[:6], (0.0, 0.01, 0.02, 0.05, 0.1, 0.2), strict=True):
        before = cpu_seconds()
        solve(scene, name, time_limit=time_limit)
        assert cpu_seconds() - before < time_limit + 0.2


DRIVER = """
import subprocess, sys
subprocess.run([sys.executable, "-c", {child!r}])
sys.exit(12)
"""


def driver(folder: Path, child: str) -> Path:
    """A driver script as Fast Downward's: it starts a search in a process of its own."""
    path = folder / "driver.py"
    path.write_text(DRIVER.format(child=child))
    return path


def test_cpu_time_of_an_external_planner_is_counted(tmp_path: Path) -> None:
    busy = "import time\nwhile time.process_time() < 0.4: pass"
    found = Planner(FETCH, engine=FastDownward(driver=driver(tmp_path, busy))).solve(FREE, "object_00", "ngr")
    assert isinstance(found, Infeasible)
    assert found.stats.task_planning_s >= 0.35
    assert found.stats.total_s >= found.stats.task_planning_s


def is_running(pid: int) -> bool:
    """Whether a process runs; one that has ended but that nobody has waited for does not."""
    status = Path(f"/proc/{pid}/status")
    return status.exists() and "State:\tZ" not in status.read_text()


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc")
def test_an_external_planner_ends_with_its_children(tmp_path: Path) -> None:
    note = tmp_path / "pid"
    child = f"import os, pathlib, time; pathlib.Path({str(note)!r}).write_text(str(os.getpid())); time.sleep(60)"
    engine = FastDownward(driver=driver(tmp_path, child))
    found = engine.plan(obstruction_problem("a", {"a": {"b"}}), 2.0)
    assert isinstance(found, NoPlan)
    assert found.reason == "gave up"
    time.sleep(0.2)
    assert not is_running(int(note.read_text()))


def test_where_no_motion_leads_to_any_grasp_the_cause_is_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(motion_layer, "plan_pick", lambda *_, **__: NoPath("no way"))
    found = solve(table_scene(cylinder("object_00", 0.3, 0.45)), "object_00", "ngr")
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.MOTION
    assert "object_00" in found.detail


LOADED_BY_SOLVES = """
import gc
import numpy as np
from numba.core.dispatcher import Dispatcher
from assets.robots import FETCH
from planners import Planner, warmup
from clutter_env.simulation.ee_control import TcpFollower
from tests.planners.scenes import random_scene

def loaded():
    kernels = [d for d in gc.get_objects() if isinstance(d, Dispatcher) and d.py_func.__module__.startswith("planners")]
    return {(d.py_func.__qualname__, str(s)) for d in kernels for s in d.overloads}

warmup()
before = loaded()
assert before
scene = random_scene(20, 0)
for planner in (Planner(FETCH), Planner(FETCH, follower=TcpFollower(FETCH))):
    for name in scene.names[:5]:
        for strategy in ("lookahead", "srivastava"):
            planner.solve(scene, name, strategy, time_limit=5.0)
print(*(name for name, _ in loaded() - before))
"""


def test_a_warmed_up_process_loads_and_compiles_nothing_in_a_solve() -> None:
    done = subprocess.run([sys.executable, "-c", LOADED_BY_SOLVES], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_warming_up_again_is_cheap_and_silent(caplog: pytest.LogCaptureFixture) -> None:
    planner = Planner(FETCH)
    planner.warmup()
    before = time.perf_counter()
    for _ in range(100):
        planner.warmup()
    assert time.perf_counter() - before < 0.1
    assert not caplog.records


def test_whoever_waits_for_compilation_is_told_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(warming, "_warm", set())

    def compile_two(*_: object) -> None:
        for _ in range(2):
            with event.trigger_event("numba:compile"):
                pass

    with caplog.at_level(logging.WARNING):
        warming.warm_once(Planner(FETCH), compile_two)
    assert [record.message for record in caplog.records] == [
        "compiling the planner's kernels, once per machine (some minutes)"
    ]


def test_a_solve_ends_at_its_time_limit_while_kernels_are_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    """A new process took 2.8 s for a solve with a limit of 0.01 s: loading the kernels did not count."""
    monkeypatch.setattr(warming, "_warm", set())
    may_end, calls = threading.Event(), []

    def load(*arguments: object) -> None:
        calls.append(arguments)
        may_end.wait()

    monkeypatch.setattr(Planner, "_exercise", load)
    found = solve(FREE, "object_00", time_limit=0.01)
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.TIME_LIMIT
    assert "warmup()" in found.detail
    may_end.set()
    assert isinstance(solve(FREE, "object_00", time_limit=60.0), Solution)
    assert len(calls) == 1, "the second solve waits for what the first one began"


def test_what_fails_while_kernels_are_loaded_is_raised_in_the_solve(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(warming, "_warm", set())
    monkeypatch.setattr(Planner, "_exercise", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        solve(FREE, "object_00", time_limit=60.0)


def test_compilation_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiling takes longer than the time limit, and one kernel is compiled inside another one."""
    monkeypatch.setattr(warming, "_warm", set())

    def compile_one(_scene: object, _target: str) -> None:
        with event.trigger_event("numba:compile"), event.trigger_event("numba:compile"):
            time.sleep(0.3)

    deadline = Deadline.after(0.1)
    later = warming.warm_once(Planner(FETCH), compile_one, deadline)
    assert deadline.is_over
    assert not later.is_over
    assert 0.3 <= later.at - deadline.at < 0.5


def refusal(cause: Cause) -> Infeasible:
    return Infeasible(cause, f"evidence of {cause}", target="object_00")


@pytest.mark.parametrize(
    ("causes", "is_proved", "is_late", "expected"),
    [
        ([Cause.NO_CLEARANCE_LOCATION], False, True, Cause.TIME_LIMIT),
        ([Cause.NO_CLEARANCE_LOCATION, Cause.TIME_LIMIT], True, True, Cause.TIME_LIMIT),
        ([Cause.NO_CLEARANCE_LOCATION, Cause.MOTION], False, False, Cause.MOTION),
        ([Cause.UNREACHABLE], True, True, Cause.UNREACHABLE),
        ([Cause.UNREACHABLE, Cause.NO_CLEARANCE_LOCATION], False, False, Cause.NO_CLEARANCE_LOCATION),
    ],
)
def test_a_refusal_that_is_not_proved_is_the_time_limits_once_the_time_is_up(
    causes: list[Cause], is_proved: bool, is_late: bool, expected: Cause
) -> None:
    """9 of 12 refusals for want of a location had used up their time. The fourth is proved by the grasps alone."""
    found = best_outcome([refusal(cause) for cause in causes], is_proved, Deadline(0.0 if is_late else math.inf))
    assert isinstance(found, Infeasible)
    assert found.cause is expected
    assert f"evidence of {causes[0]}" in found.detail or not is_late


class GetsStuck:
    """Says at every second call that objects wait for one another."""

    def __init__(self) -> None:
        self.calls = 0

    def plan(self, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
        self.calls += 1
        return Recorder().plan(problem, time_limit) if self.calls % 2 else NoPlan("cyclic", (problem.target,))


def test_after_a_refuted_motion_the_grasps_alone_are_not_the_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    """The floor was 1 or more there, so a self-clearable set exists."""
    monkeypatch.setattr(motion_layer, "plan_pick", lambda *_, **__: BlockedBy(frozenset({"object_01"}), "grasp"))
    scene = table_scene(cylinder("object_00", 0.0, 0.0), cylinder("object_01", 0.0, 0.3))
    found = Planner(FETCH, engine=GetsStuck()).solve(scene, "object_00", "ngr")
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.MOTION


COLD_SOLVE = """
from planners import Solution, solve
from tests.planners.scenes import cylinder, table_scene

found = solve(table_scene(cylinder("object_00", 0.0, 0.0)), "object_00", time_limit=10.0)
assert isinstance(found, Solution), found
assert found.stats.total_s < 10.0
"""


@pytest.mark.slow
def test_on_a_cold_kernel_cache_compiling_does_not_count(tmp_path: Path) -> None:
    """Compiling takes minutes, the solve after it less than its limit of 10 s."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", COLD_SOLVE]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("compiling the planner's kernels") == 1
