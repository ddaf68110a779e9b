"""Symbolic part of the planner: facts with references, the task-planning problem, and the results of a task planner.

Symbols such as `robot_gp_object_36` are references (Lee & Kim 2019, section 3.2): names for poses and paths that are
assumed to exist until motion planning binds or refutes them. Names follow the paper's Fig. 13.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Literal, NamedTuple, Protocol, TypeAlias, runtime_checkable

from assets import path

Atom: TypeAlias = tuple[str, ...]
"""A ground fact: predicate, then symbols."""

GRIPPER = "robot_gripper"
"""The gripper of a robot that acts with one arm."""
ROBOT_INIT_LOC = "robot_init_loc"
"""Symbol of the robot's initial base pose."""

_DECIDES = {
    "objectAt": 1,
    "occupied": 1,
    "obstacle": 1,
    "isGrasp": 2,
    "isBaseMotion": 2,
    "outOfReach": 2,
    "isPlacementLocation": 2,
    "isClearanceLocation": 2,
    "waitsFor": 1,
    "putAfter": 1,
    "isMotion": 3,
    "obstructs": 3,
}
"""Argument that decides whether a fact is relevant for the target. Facts with other predicates always are."""
_LEGAL_SYMBOL, _CODE = re.compile(r"[a-z][a-z0-9_-]*"), re.compile(r"u-([0-9a-f]{2})+")
"""Legal names in PDDL, and names that encode the bytes of others."""


class SymbolError(ValueError):
    """A fact unknown to the domain."""


@dataclass(frozen=True)
class SymbolicState:
    """Facts that hold, and location symbols that must not be offered again.

    Attributes:
        facts: ground atoms. All others are false.
        retired: locations used before. A new location gets a new symbol.
        holds_aside: whether a gripper may hold an object while another gripper takes the next.
    """

    facts: frozenset[Atom]
    retired: frozenset[str] = frozenset()
    holds_aside: bool = False

    @cached_property
    def _by_predicate(self) -> dict[str | None, list[Atom]]:
        found: dict[str | None, list[Atom]] = defaultdict(list)
        for fact in self.facts:
            found[fact[0]].append(fact)
        return found

    def find(self, *pattern: str | None) -> list[Atom]:
        """Find the facts, sorted, that match a predicate and its arguments. None matches any argument."""
        facts = self._by_predicate.get(pattern[0], ())
        for place, symbol in enumerate(pattern):
            if place and symbol is not None:
                facts = [fact for fact in facts if fact[place] == symbol]
        return sorted(facts)

    def changed(self, add: Iterable[Atom] = (), remove: Iterable[Atom] = ()) -> SymbolicState:
        """The state without the facts of `remove` and with those of `add`."""
        return replace(self, facts=(self.facts - frozenset(remove)) | frozenset(add))

    @property
    def all_held(self) -> tuple[str, ...]:
        """The objects in the grippers, by name."""
        return tuple(fact[1] for fact in self.find("graspedBy", None, None))

    @cached_property
    def grippers(self) -> tuple[str, ...]:
        """All grippers, by name."""
        return tuple(sorted(fact[-1] for kind in ("empty", "graspedBy") for fact in self._by_predicate.get(kind, ())))

    def gripper_for(self, name: str) -> str:
        """The gripper that holds an object, or the first gripper that reaches all its grasps."""
        holding = self.find("graspedBy", name, None)
        if holding:
            return holding[0][2]
        poses = {fact[1] for fact in self.find("isGrasp", None, name, None)}
        short = {gripper for _, gripper, pose in self.find("outOfReach", None, None) if pose in poses}
        return next((gripper for gripper in self.grippers if gripper not in short), GRIPPER)

    @property
    def robot_at(self) -> str:
        """Symbol of the robot's present base pose."""
        return self.find("robotAt", None)[0][1]

    def blockers(self) -> dict[str, dict[str, set[str]]]:
        """Obstructing objects: blocked object → arm trajectory → blocking objects."""
        found: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
        for _, blocker, trajectory, name in self.find("obstructs", None, None, None):
            found[name][trajectory].add(blocker)
        return {blocked: dict(by_trajectory) for blocked, by_trajectory in found.items()}


@dataclass(frozen=True)
class TaskProblem:
    """Task: reach a state in which a gripper holds the target, and objects are at their goal locations.

    Attributes:
        state: the facts at the start.
        target: name of the object to hold, by the gripper that reaches the grasp chosen for it. "" for none.
        placed: the goal facts `objectAt`.
    """

    state: SymbolicState
    target: str
    placed: tuple[Atom, ...] = ()

    @property
    def domain(self) -> str:
        """The PDDL domain of the problem."""
        return domain_text(self.state.holds_aside)

    @property
    def goal(self) -> Atom:
        """The fact that the target is held."""
        return ("graspedBy", self.target, self.state.gripper_for(self.target))

    @property
    def goals(self) -> frozenset[Atom]:
        """All goal facts."""
        return frozenset((*self.placed, self.goal) if self.target else self.placed)

    @property
    def is_solved(self) -> bool:
        """Whether all goal facts already hold."""
        return self.goals <= self.state.facts

    def relevant_objects(self) -> frozenset[str]:
        """Names of the target, objects to place, everything that directly or transitively obstructs them, and held
        objects."""
        blockers = self.state.blockers()
        relevant = {self.target, *(fact[1] for fact in self.placed), *self.state.all_held} - {""}
        frontier = [*relevant]
        while frontier:
            for names in blockers.get(frontier.pop(), {}).values():
                frontier.extend(names - relevant)
                relevant |= names
        return frozenset(relevant)

    def pruned(self) -> TaskProblem:
        """Remove the irrelevant objects. The result has the same shortest plans."""
        kept = set(self.relevant_objects())
        grasps = [fact for fact in self.state.facts if fact[0] == "isGrasp" and fact[2] in kept]
        kept |= {symbol for _, arm_pose, _, location in grasps for symbol in (arm_pose, location)}
        kept |= {fact[2] for fact in self.state.facts if fact[0] == "isMotion" and fact[3] in kept}
        facts = frozenset(fact for fact in self.state.facts if fact[_DECIDES.get(fact[0], 0)] in kept | {fact[0]})
        return replace(self, state=replace(self.state, facts=facts))

    def text(self) -> str:
        """The problem in PDDL, for `assets/pddl/domain.pddl`. Illegal names are encoded.

        Raises:
            SymbolError: a fact that the domain does not know.
        """
        kinds = {_in_code(symbol): kind for symbol, kind in self._kinds().items()}
        by_kind = {kind: sorted(one for one in kinds if kinds[one] == kind) for kind in sorted({*kinds.values()})}
        objects = "\n".join(f"    {' '.join(names)} - {kind}" for kind, names in by_kind.items())
        facts = "\n".join(
            f"    {format_atom((fact[0], *map(_in_code, fact[1:])))}" for fact in sorted(self.state.facts)
        )
        wanted = " ".join(format_atom((fact[0], *map(_in_code, fact[1:]))) for fact in sorted(self.goals))
        wanted = wanted if len(self.goals) == 1 else f"(and {wanted})"
        return (
            "(define (problem take-target)\n  (:domain obstructed-grasp)\n"
            f"  (:objects\n{objects})\n  (:init\n{facts})\n  (:goal {wanted}))\n"
        )

    def _kinds(self) -> dict[str, str]:
        """The type of every symbol."""
        kinds: dict[str, str] = {}
        known = _argument_types()
        for predicate, *arguments in (*self.state.facts, *self.goals):
            types = known.get(predicate, ())
            if len(types) != len(arguments):
                raise SymbolError(f"no fact of the domain: {predicate}{tuple(arguments)}; known: {known}")
            for symbol, kind in zip(arguments, types, strict=True):
                if kinds.setdefault(symbol, kind) != kind:
                    raise SymbolError(f"{symbol!r} is used both as {kinds[symbol]} and as {kind}")
        return kinds


def _in_code(symbol: str) -> str:
    """Name of a symbol in PDDL: the symbol itself if it is legal, or its code."""
    is_legal = _LEGAL_SYMBOL.fullmatch(symbol) and not _CODE.fullmatch(symbol)
    return symbol if is_legal else f"u-{symbol.encode().hex()}"


def symbol_of(name: str) -> str:
    """Symbol of a name in PDDL, the inverse of the encoding."""
    return bytes.fromhex(name[2:]).decode() if _CODE.fullmatch(name) else name


class GroundAction(NamedTuple):
    """Action of the domain with its arguments, in the order of Fig. 4.

    MoveBase(pose1, pose2, traj), PickUp(obj, gripper, pose1, pose2, traj, objLoc), PutDownGeneral(obj, gripper, pose1,
    pose2, traj, targetLoc), PutDownForClearance(obs, tar, gripper, pose1, pose2, traj, targetLoc).
    """

    name: str
    args: tuple[str, ...]

    @property
    def object(self) -> str | None:
        """The object taken or put down, None for a base motion."""
        return None if self.name == "MoveBase" else self.args[0]

    @property
    def gripper(self) -> str | None:
        """The gripper that takes or puts down, None for a base motion."""
        return None if self.name == "MoveBase" else self.args[2 if self.name == "PutDownForClearance" else 1]

    def __str__(self) -> str:
        return f"{self.name}({', '.join(self.args)})"


@dataclass(frozen=True)
class TaskPlan:
    """Actions that lead to the goal if every reference in them can be bound. `engine` names the planner that found
    them."""

    actions: tuple[GroundAction, ...]
    engine: str = ""


Reason: TypeAlias = Literal["cyclic", "no grasp", "no location", "unsolvable", "gave up"]


@dataclass(frozen=True)
class NoPlan:
    """Answer of a task planner without a plan, with its reason.

    Attributes:
        reason: "cyclic": the objects of `evidence` wait for each other in every order. "no grasp": the objects of
            `evidence` have no grasp. "no location": the objects of `evidence` must be moved but have no location.
            "unsolvable": proved, for another reason. "gave up": not proved, because of the time limit or an incomplete
            engine.
        evidence: names of the objects concerned.
        engine: name of the task planner.
    """

    reason: Reason
    evidence: tuple[str, ...] = ()
    engine: str = ""


@runtime_checkable
class TaskPlanner(Protocol):
    """Solver of a `TaskProblem`: one of `planners.symbolic.engines`, or the user's own object.

    Its name in reports is its attribute `name` or, without one, the name of its class.
    """

    def plan(self, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
        """Find a plan for the problem, or the reason why none is found.

        Args:
            problem: problem without irrelevant objects. `problem.text()` is its PDDL, `domain_text()` the domain's.
                `symbol_of` converts names in the text to those of the plan.
            time_limit: wall time [s]. A planner that does not finish in time returns `NoPlan("gave up")`.
        """
        ...


_ALL_EMPTY, _ONE_EMPTY = "(forall (?any - gripper) (empty ?any))", "(empty ?gripper)"
"""Condition of PickUp on the grippers: that of the paper, and that with objects held aside."""


@cache
def domain_text(holds_aside: bool = False) -> str:
    """The PDDL domain. With `holds_aside`, a gripper may take an object while another gripper holds an object."""
    text = path("pddl/domain.pddl").read_text(encoding="utf-8")
    return text.replace(_ALL_EMPTY, _ONE_EMPTY) if holds_aside else text


@cache
def _argument_types() -> dict[str, tuple[str, ...]]:
    """Types of the arguments of the domain's predicates, which give the type of every symbol in the problem text."""
    declared = re.sub(r";.*", "", domain_text()).partition("(:predicates")[2].partition("(:action")[0]
    return {name: tuple(re.findall(r"- (\S+)", rest)) for name, rest in re.findall(r"\((\w+)([^()]*)\)", declared)}


def format_atom(atom: Atom) -> str:
    """Format a fact in PDDL."""
    return f"({' '.join(atom)})"


def format_plan(actions: Iterable[GroundAction], robot: str = "fetch") -> str:
    """Format a plan as in the paper (Fig. 13): number and action in capitals, arguments on the next line."""
    lines = []
    for number, action in enumerate(actions, start=1):
        lines.append(f"{number} {action.name.upper()}_{robot.upper()}")
        lines.append(f"({' '.join(action.args).upper()})")
    return "\n".join(lines)
