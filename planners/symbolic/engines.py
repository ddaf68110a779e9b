"""Task planners behind one protocol: kairos in process, Fast Downward as a process of its own, unified-planning, A*."""

from __future__ import annotations

import importlib
import inspect
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from planners.symbolic.astar import SearchTimeoutError, shortest_plan
from planners.symbolic.checking import without_detours
from planners.symbolic.diagnosis import why_unsolvable
from planners.symbolic.problem import GroundAction, NoPlan, TaskPlan, TaskPlanner, TaskProblem

__all__ = [
    "ENGINES",
    "AStar",
    "EngineFailedError",
    "FastDownward",
    "Kairos",
    "MissingEngineError",
    "UnifiedPlanning",
    "UnknownEngineError",
    "default_engine",
    "task_planner",
]

ENGINES = ("kairos", "astar", "fast-downward", "up:NAME")
"""Names that `task_planner` knows; NAME is any engine of unified-planning."""

_ACTION_NAMES = {name.lower(): name for name in ("MoveBase", "PickUp", "PutDownGeneral", "PutDownForClearance")}
_UNIFIED_PLANNING = "up:"


_VALID = (
    f"valid names: {', '.join(ENGINES)}; or an object with a method plan(problem, time_limit) that returns a TaskPlan "
    "or a NoPlan"
)


class UnknownEngineError(ValueError):
    """No task planner of that name, or an object that is none; the message says what is valid."""


class MissingEngineError(ValueError):
    """The task planner is not installed; the message says how to install it."""


class EngineFailedError(RuntimeError):
    """The task planner broke down: neither a plan nor a proof that there is none. Carries its output."""


def task_planner(choice: str | TaskPlanner | None = None) -> TaskPlanner:
    """The task planner of that name, the same object if it is a task planner already, or the default one.

    Args:
        choice: one of `ENGINES`, any object with the `TaskPlanner` protocol, or None for `default_engine`.

    Raises:
        UnknownEngineError: neither; the message lists the valid names and says what an object must have.
        MissingEngineError: it is not installed; the message says how to install it.
    """
    if choice is not None and not isinstance(choice, str):
        return _task_planner_object(choice)
    match default_engine() if choice is None else choice:
        case "kairos":
            return Kairos()
        case "astar":
            return AStar()
        case "fast-downward":
            return FastDownward()
        case str(other) if other.startswith(_UNIFIED_PLANNING):
            return UnifiedPlanning(other.removeprefix(_UNIFIED_PLANNING))
        case _:
            raise UnknownEngineError(f"no task planner {choice!r}; {_VALID}")


def default_engine() -> str:
    """kairos where it is installed (its wheels are for Linux), otherwise our own A*."""
    return "kairos" if find_spec("kairos") else "astar"


class Kairos:
    """kairos-planner, in process: a few milliseconds a plan."""

    name = "kairos"

    def __init__(self) -> None:
        """Load the domain.

        Raises:
            MissingEngineError: kairos is not installed.
        """
        self._kairos = _require("kairos", "kairos-planner")

    @cached_property
    def _domains(self) -> dict[str, Any]:
        """The parsed domains by their text."""
        return {}

    def plan(self, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
        """A plan for the problem, found within `time_limit` [s].

        Raises:
            EngineFailedError: kairos ended without plan or proof, and not by the time limit.
        """
        domain = self._domains.get(problem.domain) or self._kairos.parse_domain(problem.domain)
        self._domains[problem.domain] = domain
        parsed = self._kairos.parse_problem(problem.text(), domain)
        result = self._kairos.Planner().solve(parsed, anytime=False, timeout=time_limit)
        status = self._kairos.Status
        if result.status == status.SOLVED:
            return _task_plan((_action(step.name, step.args) for step in result.plan.steps), self.name)
        if result.status == status.UNSOLVABLE:
            return _no_plan(problem, self.name, proved=True)
        if result.status in (status.TIMEOUT, status.NO_PLAN_FOUND):
            return _no_plan(problem, self.name, proved=False)
        raise EngineFailedError(f"kairos: {result.status}: {'; '.join(map(str, result.diagnostics))}")


class AStar:
    """Our own A* search (`planners.symbolic.astar`): nothing to install, shortest plans."""

    name = "astar"

    def plan(self, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
        """A shortest plan for the problem, found within `time_limit` [s]."""
        try:
            actions = shortest_plan(problem, time_limit)
        except SearchTimeoutError:
            return _no_plan(problem, self.name, proved=False)
        return _no_plan(problem, self.name, proved=True) if actions is None else _task_plan(actions, self.name)


@dataclass(frozen=True)
class FastDownward:
    """Fast Downward as a process of its own; it is never imported, which its licence would not suit.

    Attributes:
        search: the search it runs.
        driver: its driver script.
    """

    search: str = "eager_greedy([ff()])"
    driver: Path = field(default_factory=lambda: _fast_downward_driver())
    name: str = "fast-downward"

    def plan(self, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
        """A plan for the problem, found within `time_limit` [s].

        Raises:
            EngineFailedError: Fast Downward broke down; the message carries the end of its output.
        """
        with tempfile.TemporaryDirectory(prefix="take-target-") as folder:
            try:
                code, output = self._run(Path(folder), problem, time_limit)
            except subprocess.TimeoutExpired:
                return _no_plan(problem, self.name, proved=False)
            match code:
                case 0:
                    return _task_plan(_read_plan(Path(folder, "plan").read_text(encoding="utf-8")), self.name)
                case 10 | 11:  # exit codes of its documentation: proved by the translator, by the search
                    return _no_plan(problem, self.name, proved=True)
                case 12 | 21 | 23:  # search incomplete; out of time
                    return _no_plan(problem, self.name, proved=False)
        raise EngineFailedError(f"Fast Downward ended with exit code {code}: {output[-2000:]}")

    def _run(self, folder: Path, problem: TaskProblem, time_limit: float) -> tuple[int, str]:
        (folder / "domain.pddl").write_text(problem.domain, encoding="utf-8")
        (folder / "problem.pddl").write_text(problem.text(), encoding="utf-8")
        files = ["--plan-file", "plan", "domain.pddl", "problem.pddl"]
        command = [sys.executable, str(self.driver), *files, "--search", self.search]
        with subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
        ) as process:
            try:
                output, _ = process.communicate(timeout=time_limit)
            except subprocess.TimeoutExpired:
                _kill_with_children(process)
                raise
        return process.returncode, output


class UnifiedPlanning:
    """Any one-shot planner that unified-planning knows by name."""

    def __init__(self, engine: str) -> None:
        """Find the engine.

        Raises:
            MissingEngineError: unified-planning or the engine is not installed.
        """
        self.name = f"{_UNIFIED_PLANNING}{engine}"
        shortcuts = _require("unified_planning.shortcuts", "unified-planning")
        shortcuts.get_environment().credits_stream = None
        known = shortcuts.get_environment().factory.engines
        if engine not in known:
            raise MissingEngineError(
                f"unified-planning has no engine {engine!r} here; it has: {', '.join(known)}; "
                f"to add one: pip install 'unified-planning[{engine}]' or the engine's own package"
            )
        self._engine = engine
        self._shortcuts = shortcuts
        self._reader = importlib.import_module("unified_planning.io").PDDLReader

    def plan(self, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
        """A plan for the problem, found within `time_limit` [s].

        Raises:
            EngineFailedError: the engine broke down or does not support the domain.
        """
        parsed = self._reader().parse_problem_string(problem.domain, problem.text())
        with self._shortcuts.OneshotPlanner(name=self._engine) as engine:
            result = engine.solve(parsed, timeout=time_limit)
        status = result.status.name
        if result.plan is not None:
            steps = result.plan.actions
            return _task_plan((_action(s.action.name, map(str, s.actual_parameters)) for s in steps), self.name)
        if status in ("UNSOLVABLE_PROVEN", "UNSOLVABLE_INCOMPLETELY", "TIMEOUT"):
            return _no_plan(problem, self.name, proved=status == "UNSOLVABLE_PROVEN")
        raise EngineFailedError(f"{self.name}: {status}")


def _kill_with_children(process: subprocess.Popen[str]) -> None:
    """End a process that leads a session of its own, and what it has started: its driver does not end its search."""
    if hasattr(os, "killpg"):
        os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()


def _task_planner_object(choice: TaskPlanner) -> TaskPlanner:
    """The object, once it is known to have the protocol; its answers are checked where it is called."""
    if isinstance(choice, type):
        raise UnknownEngineError(f"the class {choice.__name__} was given; give an instance of it, or one of: {_VALID}")
    if not isinstance(choice, TaskPlanner):
        raise UnknownEngineError(f"{choice!r} is no task planner; {_VALID}")
    try:
        inspect.signature(choice.plan).bind(None, 1.0)
    except TypeError as error:
        raise UnknownEngineError(
            f"plan() of {choice!r} cannot be called as plan(problem, time_limit): {error}"
        ) from None
    return choice


def _task_plan(actions: Iterable[GroundAction], engine: str) -> TaskPlan:
    return TaskPlan(without_detours(actions), engine)


def _no_plan(problem: TaskProblem, engine: str, proved: bool) -> NoPlan:
    """The engine's verdict, with the cause where one of the usual causes can be shown."""
    cause = why_unsolvable(problem)
    if cause is not None:
        return NoPlan(*cause, engine)
    return NoPlan("unsolvable" if proved else "gave up", (), engine)


def _action(name: str, arguments: Iterable[str]) -> GroundAction:
    """An action in the domain's spelling; planners fold names to lower case."""
    return GroundAction(_ACTION_NAMES[name.lower()], tuple(argument.lower() for argument in arguments))


def _read_plan(text: str) -> tuple[GroundAction, ...]:
    """The actions of an IPC plan file: one a line in parentheses, comments after ";"."""
    lines = (line.partition(";")[0].strip().strip("()").split() for line in text.splitlines())
    return tuple(_action(words[0], words[1:]) for words in lines if words)


def _require(module: str, package: str) -> Any:
    """An optional module.

    Raises:
        MissingEngineError: it is not installed.
    """
    if find_spec(module.partition(".")[0]) is None:
        raise MissingEngineError(f"this task planner is not installed; install it with: pip install {package}")
    return importlib.import_module(module)


def _fast_downward_driver() -> Path:
    spec = find_spec("up_fast_downward")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        driver = Path(folder, "downward", "fast-downward.py")
        if driver.is_file():
            return driver
    raise MissingEngineError("Fast Downward is not installed; install it with: pip install up-fast-downward")
