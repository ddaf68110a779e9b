"""Which grasp each object's references stand for: the choice that decides what is in whose way.

To commit to a target is to choose a grasp for it, for every object in the way of that grasp, for every object in the
way of those, and so on, such that no object waits for itself. The task planner gets the choices as facts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from planners.cause import Cause
from planners.clearing.minimum_clearances import FloorLimits, FloorResult, self_clearable_sets
from planners.clock import NO_DEADLINE, Deadline
from planners.grasping.candidates import GraspCandidate
from planners.scene import Scene

__all__ = [
    "CandidateSource",
    "Commitments",
    "ExcludingObjects",
    "NoCommitment",
    "greedy_commitments",
    "smallest_commitments",
    "varied_commitments",
]


Volume: TypeAlias = Callable[[GraspCandidate], int]
"""What a grasp sweeps, as bits: one for each of a number of cells."""


class CandidateSource(Protocol):
    """Where grasps come from."""

    def for_object(self, scene: Scene, name: str) -> tuple[GraspCandidate, ...]:
        """Grasps of that object where it stands, with what blocks each now; best first."""
        ...

    def from_base(self, scene: Scene, name: str, base: NDArray[np.float64]) -> tuple[GraspCandidate, ...]:
        """Grasps of that object from one base pose (3,); best first."""
        ...


@dataclass(frozen=True)
class ExcludingObjects:
    """The same grasps without those of some objects, which then stay where they are."""

    source: CandidateSource
    names: frozenset[str]

    def for_object(self, scene: Scene, name: str) -> tuple[GraspCandidate, ...]:
        """As `CandidateSource.for_object`."""
        return () if name in self.names else self.source.for_object(scene, name)

    def from_base(self, scene: Scene, name: str, base: NDArray[np.float64]) -> tuple[GraspCandidate, ...]:
        """As `CandidateSource.from_base`."""
        return () if name in self.names else self.source.from_base(scene, name, base)


@dataclass(frozen=True)
class Commitments:
    """A grasp for the target and for every object that must go before it.

    Attributes:
        target: the object wanted.
        order: objects to clear, in an order in which each grasp is free when it is taken.
        grasps: the chosen grasp of each of them and of the target.
    """

    target: str
    order: tuple[str, ...]
    grasps: Mapping[str, GraspCandidate]

    def blockers(self, scene: Scene) -> dict[str, tuple[str, ...]]:
        """What is in the way of each chosen grasp, by name."""
        return {name: scene.names_of(grasp.blockers) for name, grasp in self.grasps.items()}

    def with_grasp(self, grasp: GraspCandidate) -> Commitments:
        """The same with another grasp of one object."""
        return replace(self, grasps=MappingProxyType({**self.grasps, grasp.object: grasp}))

    def without(self, name: str) -> Commitments:
        """What remains once that object has been cleared."""
        kept = {other: grasp for other, grasp in self.grasps.items() if other != name}
        return Commitments(self.target, tuple(o for o in self.order if o != name), MappingProxyType(kept))


@dataclass(frozen=True)
class NoCommitment:
    """No commitments are possible: the cause, and the objects concerned; `proved` if it follows from all grasps."""

    cause: Cause
    objects: tuple[str, ...]
    proved: bool = True


def greedy_commitments(
    source: CandidateSource, scene: Scene, target: str, deadline: Deadline = NO_DEADLINE
) -> Commitments | NoCommitment:
    """Every object takes the grasp with the fewest objects in its way, whatever else is chosen.

    Grasps that would make an object wait for itself are passed over.
    """
    grasps: dict[str, GraspCandidate] = {}
    order: list[str] = []

    def commit(name: str, waiting: int) -> bool:
        """Commit to a grasp of that object and of all in its way, none of which may block those of `waiting`."""
        waiting |= 1 << scene.index(name)
        for option in sorted(source.for_object(scene, name), key=lambda option: option.blockers.bit_count()):
            if deadline.is_over:
                return False
            if option.blockers & waiting:
                continue
            kept, kept_order = dict(grasps), list(order)
            blockers = [blocker for blocker in scene.names_of(option.blockers) if blocker not in grasps]
            if all(blocker in grasps or commit(blocker, waiting) for blocker in blockers):
                grasps[name] = option
                order.append(name)
                return True
            grasps.clear()
            grasps.update(kept)
            order[:] = kept_order
        return False

    if commit(target, 0):
        return Commitments(target, tuple(order[:-1]), MappingProxyType(grasps))
    if deadline.is_over:
        return NoCommitment(Cause.TIME_LIMIT, (target,), proved=False)
    reachable = bool(source.for_object(scene, target))
    return NoCommitment(Cause.NO_SELF_CLEARABLE_SET if reachable else Cause.UNREACHABLE, (target,))


def smallest_commitments(
    source: CandidateSource,
    scene: Scene,
    target: str,
    *,
    slack: int = 1,
    limits: FloorLimits | None = None,
    deadline: Deadline = NO_DEADLINE,
) -> Iterator[Commitments | NoCommitment]:
    """Commitments to the smallest self-clearable sets, fewest clearances first, up to `slack` more than the fewest.

    A single `NoCommitment` where there is no self-clearable set.
    """
    names = scene.names

    def masks(index: int) -> list[int]:
        """What is in the way of each grasp of that object."""
        return [option.blockers for option in source.for_object(scene, names[index])]

    for result in self_clearable_sets(masks, scene.index(target), slack=slack, limits=limits, deadline=deadline):
        if result.count is None:
            yield NoCommitment(Cause(result.cause), (target,), result.proved)
            return
        yield _committed(source, scene, target, result)


def varied_commitments(
    source: CandidateSource, scene: Scene, commitments: Commitments, rng: np.random.Generator, volume: Volume
) -> Commitments:
    """The same objects to clear, in another order drawn at random, through grasps that together sweep little space.

    From the target backwards each object takes, of the grasps free by its turn, the one that adds the fewest cells to
    what the later ones sweep anyway: the smaller the Negative Goal Region, the more room for what is put aside.
    """
    names = scene.names
    order = _random_order(source, scene, commitments, rng)
    grasps: dict[str, GraspCandidate] = {}
    swept = 0
    for turn in reversed(range(len(order))):
        removed = sum(1 << index for index in order[:turn])
        free = _free_options(source, scene, names[order[turn]], removed)
        added = [(swept | volume(option)).bit_count() for option in free]
        best = min(range(len(free)), key=lambda j: (added[j], -free[j].quality))
        grasps[names[order[turn]]] = free[best]
        swept |= volume(free[best])
    return Commitments(commitments.target, tuple(names[i] for i in order[:-1]), MappingProxyType(grasps))


def _random_order(
    source: CandidateSource, scene: Scene, commitments: Commitments, rng: np.random.Generator
) -> list[int]:
    """An order in which the objects can be removed, the target last."""
    waiting = {scene.index(name) for name in commitments.grasps}
    last = scene.index(commitments.target)
    order: list[int] = []
    removed = 0
    while waiting:
        ready = [
            index
            for index in sorted(waiting)
            if (index != last or len(waiting) == 1) and _free_options(source, scene, scene.names[index], removed)
        ]
        index = int(rng.choice(ready))
        order.append(index)
        waiting.remove(index)
        removed |= 1 << index
    return order


def _free_options(source: CandidateSource, scene: Scene, name: str, removed: int) -> list[GraspCandidate]:
    return [option for option in source.for_object(scene, name) if option.blockers & ~removed == 0]


def _committed(source: CandidateSource, scene: Scene, target: str, result: FloorResult) -> Commitments:
    """Each object of the set takes its best grasp among those free by its turn."""
    grasps: dict[str, GraspCandidate] = {}
    removed = 0
    for step in result.order:
        name = scene.names[step.object]
        grasps[name] = max(_free_options(source, scene, name, removed), key=lambda option: option.quality)
        removed |= 1 << step.object
    order = tuple(scene.names[index] for index in result.objects)
    return Commitments(target, order, MappingProxyType(grasps))
