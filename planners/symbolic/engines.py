"""Task planners behind one protocol: kairos in process, any engine of unified-planning, and the built-in A* (`astar`).

`answer_of` runs a planner. `checked_answer` checks the answers of built-in and user-written planners alike.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import nullcontext
from functools import cache
from importlib.util import find_spec
from typing import Any, get_args

from planners.clock import Deadline, children_counted
from planners.symbolic.astar import AStar
from planners.symbolic.problem import (
    GroundAction,
    NoPlan,
    Reason,
    SymbolicState,
    TaskPlan,
    TaskPlanner,
    TaskProblem,
    format_atom,
    symbol_of,
)
from planners.symbolic.transitions import InapplicableActionError, update_from_action

ENGINES = ("kairos", "astar", "fast-downward", "fast-downward:ff", "up:NAME")
"""Names known to `task_planner`. NAME is any engine of unified-planning, and "fast-downward" is short for one of
them."""

FF_SEARCHES = ("let(hff,ff(),ehc(hff,preferred=[hff]))", "let(hff,ff(),eager_greedy([hff]))")
"""FF (Hoffmann 2001) in Fast Downward's options: enforced hill climbing along helpful actions and, if it finds no plan,
greedy best-first search along all actions. Fast Downward is GPL, so its users install it, and no extra of this package
names it."""

_VALID = (
    f"valid names: {', '.join(ENGINES)}; or an object with a method plan(problem, time_limit) that returns a TaskPlan "
    "or a NoPlan"
)
_LONGEST = 500
"""Most characters of an engine's output that an error carries, from its end."""
_ACTION_NAMES = {name.lower(): name for name in ("MoveBase", "PickUp", "PutDownGeneral", "PutDownForClearance")}


class UnknownEngineError(ValueError):
    """No task planner of that name, or an object that is no task planner. The message lists valid choices."""


class MissingEngineError(ValueError):
    """The task planner is not installed. The message tells how to install it."""


class EngineFailedError(RuntimeError):
    """The task planner failed without a plan or a proof that no plan exists. Carries its output."""


class InvalidAnswerError(RuntimeError):
    """A task planner returned an invalid answer to its problem. The message gives the answer and the reason."""


def task_planner(choice: str | TaskPlanner | None = None) -> TaskPlanner:
    """Find the task planner of that name. A task planner is returned unchanged, None gives the default.

    Args:
        choice: one of `ENGINES`, any object with the `TaskPlanner` protocol, or None for `default_engine`.

    Raises:
        UnknownEngineError: the choice is neither. The message lists the valid names and the required method.
        MissingEngineError: it is not installed. The message tells how to install it.
    """
    match default_engine() if choice is None else choice:
        case "kairos":
            return Kairos()
        case "astar":
            return AStar()
        case "fast-downward":
            return UnifiedPlanning("fast-downward", "fast-downward")
        case "fast-downward:ff":
            searches = tuple({"fast_downward_search_config": search} for search in FF_SEARCHES)
            return UnifiedPlanning("fast-downward", "fast-downward:ff", searches)
        case str(name) if name.startswith("up:"):
            return UnifiedPlanning(name.removeprefix("up:"), name)
        case str(name):
            raise UnknownEngineError(f"no task planner {name!r}; {_VALID}")
        case type() as given:
            raise UnknownEngineError(
                f"the class {given.__name__} was given; give an instance of it, or one of: {_VALID}"
            )
        case TaskPlanner() as planner:
            try:
                inspect.signature(planner.plan).bind(None, 1.0)
            except TypeError as error:
                raise UnknownEngineError(
                    f"plan() of {planner!r} cannot be called as plan(problem, time_limit): {error}"
                ) from None
            return planner
        case other:
            raise UnknownEngineError(f"{other!r} is no task planner; {_VALID}")


def default_engine() -> str:
    """Name of the default: kairos if it is installed (its wheels are for Linux), or the built-in A*."""
    return "kairos" if find_spec("kairos") else "astar"


class Kairos:
    """kairos-planner, in process: a few milliseconds a plan."""

    name = "kairos"

    def __init__(self) -> None:
        """Load the planner. Raises `MissingEngineError`."""
        self._kairos = _require("kairos", "kairos-planner")
        self._parse_domain = cache(self._kairos.parse_domain)

    def plan(self, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
        """Find a plan for the problem within `time_limit` [s]. Raises `EngineFailedError`."""
        parsed = self._kairos.parse_problem(problem.text(), self._parse_domain(problem.domain))
        result = self._kairos.Planner().solve(parsed, anytime=False, timeout=time_limit)
        status = self._kairos.Status
        if result.status == status.SOLVED:
            return _spelled((step.name, step.args) for step in result.plan.steps)
        if result.status in (status.UNSOLVABLE, status.TIMEOUT, status.NO_PLAN_FOUND):
            return NoPlan("unsolvable" if result.status == status.UNSOLVABLE else "gave up")
        raise EngineFailedError(f"kairos: {result.status}: {'; '.join(map(str, result.diagnostics))}")


class UnifiedPlanning:
    """One-shot planner that unified-planning knows by name."""

    def __init__(self, engine: str, name: str, options: Sequence[Mapping[str, str]] = ({},)) -> None:
        """Find the engine. Raises `MissingEngineError`.

        Args:
            engine: its name in unified-planning.
            name: name under which its plans are known here.
            options: sets of parameters of the engine. Each set is tried if the previous ones find no plan.
        """
        self.name = name
        self._engine = engine
        self._options = options
        self._shortcuts = _require("unified_planning.shortcuts", f"'unified-planning[{engine}]'")
        environment = self._shortcuts.get_environment()
        environment.credits_stream = None
        factory = environment.factory
        known = [one for one in factory.engines if factory.engine(one).is_oneshot_planner()]
        if engine not in known:
            raise MissingEngineError(
                f"unified-planning has no engine {engine!r} here that plans; it has: {', '.join(known) or 'none'}; "
                f"to add one: pip install 'unified-planning[{engine}]' or the engine's own package"
            )
        self._reader = importlib.import_module("unified_planning.io").PDDLReader

    def plan(self, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
        """Find a plan for the problem within `time_limit` [s]. Raises `EngineFailedError`."""
        deadline = Deadline.after(time_limit)
        parsed = self._reader().parse_problem_string(problem.domain, problem.text())
        for options in self._options:
            if not deadline.remaining:
                break
            try:
                with self._shortcuts.OneshotPlanner(name=self._engine, params=dict(options)) as engine:
                    result = engine.solve(parsed, timeout=deadline.remaining)
            except Exception as error:  # engines are third-party code and may raise anything
                raise EngineFailedError(f"{self.name}: {type(error).__name__}: {error}") from error
            if result.plan is not None:
                steps = result.plan.actions
                return _spelled((step.action.name, map(str, step.actual_parameters)) for step in steps)
            if result.status.name == "UNSOLVABLE_PROVEN":
                return NoPlan("unsolvable")
            if result.status.name not in ("UNSOLVABLE_INCOMPLETELY", "TIMEOUT"):
                said = "; ".join(entry.message.strip() for entry in result.log_messages or ())
                raise EngineFailedError(f"{self.name}: {result.status.name}{': ' * bool(said)}{said[-_LONGEST:]}")
        return NoPlan("gave up")


_IN_PROCESS = (AStar, Kairos)
"""Task planners that start no process."""


def answer_of(planner: TaskPlanner, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
    """Run a task planner within `time_limit` [s] and check its answer. `cpu_seconds` includes the processes that it
    starts.

    Without time left, the answer is "gave up". Raises `InvalidAnswerError`, see `checked_answer`.
    """
    if time_limit <= 0:
        return checked_answer(problem, NoPlan("gave up"), planner)
    with nullcontext() if isinstance(planner, _IN_PROCESS) else children_counted():
        answer = planner.plan(problem, time_limit)
    return checked_answer(problem, answer, planner)


def checked_answer(problem: TaskProblem, answer: TaskPlan | NoPlan, planner: TaskPlanner) -> TaskPlan | NoPlan:
    """Check an answer. Returns a plan without detours, or a refusal with its cause if a usual cause can be proved.

    Raises:
        InvalidAnswerError: the answer is neither a `TaskPlan` nor a `NoPlan`, a plan has an inapplicable action or does
            not reach the goal, or a `NoPlan` has an unknown reason.
    """
    name = str(getattr(planner, "name", type(planner).__name__))
    if isinstance(answer, NoPlan):
        reasons = get_args(Reason)
        if answer.reason not in reasons:
            raise InvalidAnswerError(f"{name}: no reason {answer.reason!r}; valid reasons: {', '.join(reasons)}")
        cause = why_unsolvable(problem) if answer.reason in ("unsolvable", "gave up") else None
        return NoPlan(*(cause or (answer.reason, answer.evidence)), answer.engine or name)
    if not isinstance(answer, TaskPlan):
        raise InvalidAnswerError(
            f"plan() of the task planner {name} must return a TaskPlan or a NoPlan, not {answer!r}"
        )
    actions = without_detours(answer.actions)
    state = problem.state
    for number, action in enumerate(actions, start=1):
        try:
            state = update_from_action(state, action)
        except InapplicableActionError as error:
            raise InvalidAnswerError(f"step {number} of the plan of {name}: {error}") from error
    if missing := sorted(problem.goals - state.facts):
        raise InvalidAnswerError(f"the plan of {name} ends without {', '.join(map(format_atom, missing))}")
    return TaskPlan(actions, answer.engine or name)


def without_detours(actions: Iterable[GroundAction]) -> tuple[GroundAction, ...]:
    """Merge successive base motions of a plan into one, because any base pose can be reached from any other."""
    kept: list[GroundAction] = []
    for action in actions:
        if action.name == "MoveBase" and kept and kept[-1].name == "MoveBase":
            start = kept.pop().args[0]
            action = GroundAction("MoveBase", (start, *action.args[1:]))
            if action.args[0] == action.args[1]:
                continue
        kept.append(action)
    return tuple(kept)


def _spelled(steps: Iterable[tuple[str, Iterable[str]]]) -> TaskPlan:
    """Restore the domain's spelling of a plan, because planners fold names to lower case."""
    return TaskPlan(
        tuple(
            GroundAction(_ACTION_NAMES[name.lower()], tuple(symbol_of(arg.lower()) for arg in args))
            for name, args in steps
        )
    )


def _require(module: str, package: str) -> Any:
    """Import an optional module. Raises `MissingEngineError`."""
    if find_spec(module.partition(".")[0]) is None:
        raise MissingEngineError(f"this task planner is not installed; install it with: pip install {package}")
    return importlib.import_module(module)


def why_unsolvable(problem: TaskProblem) -> tuple[Reason, tuple[str, ...]] | None:
    """Find a usual cause why no plan can exist, with the names of the objects concerned. None without such a cause.

    Removes graspable objects one by one, at first as if a location were always free. If the target remains, it waits
    for objects that wait for each other, or for an object without any grasp. Goals with places are not examined,
    because their order is given.
    """
    if problem.placed:
        return None
    state = problem.state
    held = state.all_held
    for name in held if not state.holds_aside else ():
        if name != problem.target and not _has_free_location(state, name):
            return "no location", (name,)
    relevant = problem.relevant_objects()
    gone = _removable(state, relevant)
    if problem.target not in gone:
        ungraspable = {name for name in relevant if name not in held and not _grasp_trajectories(state, name)}
        if problem.target in _removable(state, relevant, free=ungraspable):
            return "no grasp", tuple(sorted(ungraspable))
        return "cyclic", _circle(state, relevant - gone)
    others = relevant - {problem.target} if not state.holds_aside else ()
    homeless = {name for name in others if not _locations(state, name)}
    if problem.target not in _removable(state, relevant - homeless):
        return "no location", tuple(sorted(homeless))
    return None


def _removable(state: SymbolicState, objects: Collection[str], free: Collection[str] = ()) -> set[str]:
    """`free`, the held objects, and the objects of `objects` that can be taken one by one after them."""
    blockers = state.blockers()
    gone = {*free, *state.all_held}
    while True:
        takeable = {
            name
            for name in set(objects) - gone
            if any(blockers.get(name, {}).get(path, set()) <= gone for path in _grasp_trajectories(state, name))
        }
        if not takeable:
            return gone
        gone |= takeable


def _circle(state: SymbolicState, stuck: Collection[str]) -> tuple[str, ...]:
    """Names of the stuck objects that wait for each other, directly or indirectly."""
    circle = set(stuck)
    while True:
        waited_for = {fact[1] for fact in state.find("obstructs", None, None, None) if fact[3] in circle}
        if circle <= waited_for:
            return tuple(sorted(circle))
        circle &= waited_for


def _grasp_trajectories(state: SymbolicState, name: str) -> set[str]:
    """Arm trajectories that end at a grasp of the object at its present location."""
    grasps = [g for at in state.find("objectAt", name, None) for g in state.find("isGrasp", None, name, at[2])]
    return {motion[1] for grasp in grasps for motion in state.find("isMotion", None, None, grasp[1])}


def _locations(state: SymbolicState, name: str) -> set[str]:
    """Locations offered for the object."""
    clearance = {fact[1] for fact in state.find("isClearanceLocation", None, name, None)}
    return clearance | {fact[1] for fact in state.find("isPlacementLocation", None, name)}


def _has_free_location(state: SymbolicState, held: str) -> bool:
    """Whether a held object can be put down now, without any other object moved away first."""
    blockers = state.blockers().get(held, {})
    grasps = [g for g in state.find("isGrasp", None, held, None) if g[3] in _locations(state, held)]
    return any(not blockers.get(motion[1]) for g in grasps for motion in state.find("isMotion", None, None, g[1]))
