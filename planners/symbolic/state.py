"""Facts with references: what the symbolic side of the planner knows."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

__all__ = ["GRIPPER", "ROBOT_INIT_LOC", "Atom", "SymbolicState"]

Atom: TypeAlias = tuple[str, ...]
"""A ground fact: predicate, then symbols."""

GRIPPER = "robot_gripper"
"""The gripper of a robot that acts with one arm."""
ROBOT_INIT_LOC = "robot_init_loc"
"""The base pose the robot starts from."""


@dataclass(frozen=True)
class SymbolicState:
    """The facts that hold, and the location symbols that must not be offered again.

    Attributes:
        facts: ground atoms; whatever is absent is false.
        retired: locations used before; a new location gets a new symbol.
        holds_aside: whether one gripper may hold an object while another one takes the next.
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
        """Facts that match a predicate and its arguments, None standing for any argument; sorted."""
        given = [(place, symbol) for place, symbol in enumerate(pattern) if place and symbol is not None]
        facts = self._by_predicate.get(pattern[0], ())
        for place, symbol in given:
            facts = [fact for fact in facts if fact[place] == symbol]
        return sorted(facts)

    def changed(self, add: Iterable[Atom] = (), remove: Iterable[Atom] = ()) -> SymbolicState:
        """The state without the facts of `remove` and with those of `add`."""
        return replace(self, facts=(self.facts - frozenset(remove)) | frozenset(add))

    @property
    def held(self) -> str | None:
        """The object in a gripper, the first by name of several."""
        return next(iter(self.all_held), None)

    @property
    def all_held(self) -> tuple[str, ...]:
        """The objects in the grippers, by name."""
        return tuple(fact[1] for fact in self.find("graspedBy", None, None))

    @cached_property
    def grippers(self) -> tuple[str, ...]:
        """All grippers, by name."""
        return tuple(sorted({fact[1] for fact in self.find("empty", None)} | {fact[2] for fact in self._in_hand}))

    @property
    def _in_hand(self) -> list[Atom]:
        return self.find("graspedBy", None, None)

    def gripper_for(self, name: str) -> str:
        """The gripper that holds an object, or else the first one that reaches all its grasps."""
        holding = self.find("graspedBy", name, None)
        if holding:
            return holding[0][2]
        poses = {fact[1] for fact in self.find("isGrasp", None, name, None)}
        short = {gripper for _, gripper, pose in self.find("outOfReach", None, None) if pose in poses}
        return next((gripper for gripper in self.grippers if gripper not in short), GRIPPER)

    @property
    def robot_at(self) -> str:
        """The base pose the robot is at."""
        return self.find("robotAt", None)[0][1]

    def blockers(self) -> dict[str, dict[str, set[str]]]:
        """Objects in the way: blocked object → arm trajectory → blocking objects."""
        found: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
        for _, blocker, trajectory, name in self.find("obstructs", None, None, None):
            found[name][trajectory].add(blocker)
        return {blocked: dict(by_trajectory) for blocked, by_trajectory in found.items()}
