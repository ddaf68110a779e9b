"""Grasps that the references of objects stand for: the choice that decides what is in whose way.

To commit to a target is to choose a grasp for it, for every object in the way of that grasp, for every object in the
way of those, and so on, such that no object waits for itself. The task planner gets the choices as facts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from planners.cause import Cause
from planners.clearing.lower_bound import self_clearable_sets
from planners.clock import NO_DEADLINE, Deadline
from planners.grasping.candidates import GraspCandidate, GraspCandidates
from planners.motion.arm import tcp_pose
from planners.placing.placements import PlacementSearch
from planners.scene import HeldObject, RobotState, Scene
from planners.scene.cover import drive_out, driven_out_of
from planners.strategies import Strategy


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
        """Names of what is in the way of each chosen grasp."""
        return {name: scene.names_of(grasp.blockers) for name, grasp in self.grasps.items()}

    def with_grasp(self, grasp: GraspCandidate) -> Commitments:
        """The same with another grasp of one object."""
        return replace(self, grasps=MappingProxyType({**self.grasps, grasp.object: grasp}))

    def without(self, name: str) -> Commitments:
        """The commitments that remain once that object has been cleared."""
        kept = {other: grasp for other, grasp in self.grasps.items() if other != name}
        return Commitments(self.target, tuple(o for o in self.order if o != name), MappingProxyType(kept))


@dataclass(frozen=True)
class NoCommitment:
    """No commitments are possible: the cause, and the objects concerned."""

    cause: Cause
    objects: tuple[str, ...]


@dataclass(frozen=True)
class ClearingProblem:
    """Inputs of the choice of commitments.

    Attributes:
        is_usable: whether a grasp in a scene can be used at all: whether the gripper can leave again. It is asked
            about few, before placements are looked for.
        reject: sees to it that an unusable grasp is not offered again as it was.
        order_by_task_plan: puts the objects to clear in the order in which a task plan clears them.
        left_alone: objects that stay where they are: no grasp of them is offered.
        holds_aside: whether the last obstacle may stay in one gripper while another one takes the target.
        saves_time: whether grasps are chosen that take less time.
        homeless: what is held and has been found to have no placement at all, whatever it keeps clear of.
    """

    candidates: GraspCandidates
    placements: PlacementSearch
    scene: Scene
    target: str
    strategy: Strategy
    rng: np.random.Generator
    deadline: Deadline = NO_DEADLINE
    is_usable: Callable[[Scene, GraspCandidate], bool] = lambda _scene, _grasp: True
    reject: Callable[[Scene, GraspCandidate], None] = lambda _scene, _grasp: None
    order_by_task_plan: Callable[[Commitments], Commitments] = lambda commitments: commitments
    left_alone: frozenset[str] = frozenset()
    holds_aside: bool = False
    saves_time: bool = False
    homeless: set[str] = field(default_factory=set)

    def grasps(self, scene: Scene, name: str) -> tuple[GraspCandidate, ...]:
        """Grasps of that object where it stands, with what blocks each now; best first."""
        return () if name in self.left_alone else self.candidates.for_object(scene, name)

    def grasps_from(self, scene: Scene, name: str, base: NDArray[np.float64]) -> list[GraspCandidate]:
        """Grasps of that object from one base pose (3,), best first, whatever is in their way; none under a shelf."""
        found = () if name in self.left_alone else self.candidates.from_base(scene, name, base)
        return [grasp for grasp in found if not grasp.drives]

    def free_grasps(self, name: str, removed: int) -> list[GraspCandidate]:
        """The grasps of an object that are free once those of the mask `removed` are gone."""
        return [grasp for grasp in self.grasps(self.scene, name) if grasp.blockers & ~removed == 0]


def grasped(scene: Scene, grasp: GraspCandidate) -> Scene:
    """The scene after a grasp: its arm holds the object, at home, the robot where it took it or drove out to."""
    scene = scene.using(grasp.arm)
    T_world_tcp = tcp_pose(scene.robot, RobotState(grasp.base, grasp.q, 0.0))
    held = HeldObject.grasped(scene.body(grasp.object), T_world_tcp)
    base = (
        drive_out(driven_out_of(scene, scene.body(grasp.object)), grasp.base, T_world_tcp)[-1]
        if grasp.drives
        else grasp.base
    )
    state = RobotState(base, np.array(scene.robot.home), scene.state.finger_position)
    return scene.with_state(state).with_held(held)


def greedy_commitments(problem: ClearingProblem) -> Commitments | NoCommitment:
    """Every object takes the grasp with the fewest objects in its way, whatever else is chosen.

    Grasps that would make an object wait for itself are passed over.
    """
    scene, target, deadline = problem.scene, problem.target, problem.deadline
    grasps: dict[str, GraspCandidate] = {}
    order: list[str] = []

    def commit(name: str, waiting: int) -> bool:
        """Commit to a grasp of that object and of all in its way, none of which may block those of `waiting`."""
        waiting |= 1 << scene.index(name)
        for option in sorted(problem.grasps(scene, name), key=lambda option: option.blockers.bit_count()):
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
        return NoCommitment(Cause.TIME_LIMIT, (target,))
    reachable = bool(problem.grasps(scene, target))
    return NoCommitment(Cause.NO_SELF_CLEARABLE_SET if reachable else Cause.UNREACHABLE, (target,))


def smallest_commitments(problem: ClearingProblem) -> Iterator[Commitments | NoCommitment]:
    """Commitments to the smallest self-clearable sets, fewest clearances first, up to the strategy's slack.

    A single `NoCommitment` where there is no self-clearable set.
    """
    scene, target = problem.scene, problem.target

    def masks(name: str) -> list[int]:
        """Masks of the objects in the way of each grasp of that object."""
        return [option.blockers for option in problem.grasps(scene, name)]

    slack, deadline = problem.strategy.slack, problem.deadline
    for found in self_clearable_sets(masks, target, scene.names, slack=slack, deadline=deadline):
        if found.count is None:
            yield NoCommitment(Cause(found.cause), (target,))
            return
        # Each object takes its best grasp among those that are free by its turn.
        grasps: dict[str, GraspCandidate] = {}
        for name in (*found.objects, target):
            free = problem.free_grasps(name, scene.mask(grasps))
            grasps[name] = max(free, key=lambda option: option.quality)
        yield Commitments(target, found.objects, MappingProxyType(grasps))


def varied_commitments(
    problem: ClearingProblem, commitments: Commitments, swept_cells: Callable[[GraspCandidate], int]
) -> Commitments:
    """The same objects to clear, in another order drawn at random, through grasps that together sweep little space.

    From the target backwards each object takes, of the grasps free by its turn, the one that adds the fewest cells to
    what the later ones sweep anyway: the smaller the Negative Goal Region, the more space for what is put aside.
    """
    names, order = problem.scene.names, _random_order(problem, commitments)
    grasps: dict[str, GraspCandidate] = {}
    swept = 0
    for turn in reversed(range(len(order))):
        removed = sum(1 << index for index in order[:turn])
        free = problem.free_grasps(names[order[turn]], removed)
        added = [(swept | swept_cells(option)).bit_count() for option in free]
        best = min(range(len(free)), key=lambda j: (added[j], -free[j].quality))
        grasps[names[order[turn]]] = free[best]
        swept |= swept_cells(free[best])
    return Commitments(commitments.target, tuple(names[i] for i in order[:-1]), MappingProxyType(grasps))


def _random_order(problem: ClearingProblem, commitments: Commitments) -> list[int]:
    """An order in which the objects can be removed, the target last."""
    scene = problem.scene
    waiting, last = {scene.index(name) for name in commitments.grasps}, scene.index(commitments.target)
    order: list[int] = []
    removed = 0
    while waiting:
        ready = [
            index
            for index in sorted(waiting)
            if (index != last or len(waiting) == 1) and problem.free_grasps(scene.names[index], removed)
        ]
        index = int(problem.rng.choice(ready))
        order.append(index)
        waiting.remove(index)
        removed |= 1 << index
    return order
