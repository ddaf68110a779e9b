"""Commitments: the grasps that the references stand for. They decide which objects are in the way of which.

A commitment to a target chooses a grasp for the target, for every object in the way of that grasp, and so on. No object
may wait for itself. The task planner gets the choices as facts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from planners.cause import Cause
from planners.clearing.lower_bound import self_clearable_sets
from planners.clock import NO_DEADLINE, Deadline
from planners.collision.world import objects_on
from planners.grasping.candidates import GraspCandidate, GraspCandidates
from planners.motion.arm import tcp_pose
from planners.placing.surfaces import KeepClear
from planners.scene import HeldObject, RobotState, Scene
from planners.scene.cover import drive_out, driven_out_of
from planners.scene.masks import FIXED_BITS
from planners.strategies import Strategy

Grasps: TypeAlias = Callable[[str], Sequence[GraspCandidate]]
"""Grasps of an object by its name, best first, with the blockers of each."""


@dataclass(frozen=True)
class Commitments:
    """A grasp for the target and for every object that must go before it.

    Attributes:
        target: the object to take.
        order: objects to clear, in an order in which each grasp is free at its turn.
        grasps: the chosen grasp of each object and of the target.
    """

    target: str
    order: tuple[str, ...]
    grasps: Mapping[str, GraspCandidate]

    def blockers(self, scene: Scene) -> dict[str, tuple[str, ...]]:
        """Names of the objects in the way of each chosen grasp."""
        return {name: scene.names_of(grasp.blockers) for name, grasp in self.grasps.items()}

    def without(self, name: str) -> Commitments:
        """The commitments that remain once that object has been cleared."""
        kept = {other: grasp for other, grasp in self.grasps.items() if other != name}
        return Commitments(self.target, tuple(o for o in self.order if o != name), MappingProxyType(kept))


@dataclass(frozen=True)
class NoCommitment:
    """Failure to choose commitments: the cause, the objects concerned, and whether another attempt would be in vain.

    It would be if no hand can release an object at its place, whatever else is moved.
    """

    cause: Cause
    objects: tuple[str, ...]
    is_in_vain: bool = False


def grasped(scene: Scene, grasp: GraspCandidate) -> Scene:
    """The scene after a grasp: the arm is at home and holds the object.

    The base is at the base pose of the grasp, or where it drove out to from under a shelf.
    """
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


def commitments_for(
    grasps: Grasps, scene: Scene, target: str, strategy: Strategy, deadline: Deadline = NO_DEADLINE
) -> Commitments | NoCommitment:
    """Choose the grasps of a strategy that does not plan ahead.

    Args:
        grasps: grasps of an object by name, best first, with the blockers of each.
        scene: the scene as it is.
        target: the object to take.
        strategy: "greedy" grasps, or the grasps of the "smallest" self-clearable set.
        deadline: when to stop.
    """
    choose = _greedy if strategy.grasps == "greedy" else _smallest
    return choose(grasps, scene, target, deadline)


def keep_clear(strategy: Strategy, commitments: Commitments, moving: str) -> KeepClear:
    """Grasps that a cleared object must keep clear of: NGR1, NGR1 + NGR2, or none (eq. 1-3)."""
    if strategy.region == "none":
        return KeepClear()
    target = commitments.grasps.get(commitments.target)
    if strategy.region == "ngr1":
        return KeepClear(target)
    others = (grasp for name, grasp in commitments.grasps.items() if name not in (moving, commitments.target))
    return KeepClear(target, tuple(others))


def with_blockers(candidates: GraspCandidates, scene: Scene, chosen: Iterable[GraspCandidate]) -> list[GraspCandidate]:
    """The same grasps with their blockers in a scene."""
    found = []
    for grasp in chosen:
        world = candidates.compiled.world(scene).for_arm(grasp.arm)
        own = scene.mask({grasp.object, *scene.held_names})
        hits = world.hits(grasp.base, grasp.q, grasp.opening, ignore=own) & ~FIXED_BITS
        found.append(replace(grasp, blockers=hits | objects_on(world, grasp.object)))
    return found


def _greedy(grasps: Grasps, scene: Scene, target: str, deadline: Deadline) -> Commitments | NoCommitment:
    """Choose for every object the grasp with the fewest blockers, one object after another.

    Grasps that would make an object wait for itself are skipped.
    """
    chosen: dict[str, GraspCandidate] = {}
    order: list[str] = []

    def commit(name: str, waiting: int) -> bool:
        """Choose a grasp of that object and of all its blockers. None of them may block the grasps of `waiting`."""
        waiting |= 1 << scene.index(name)
        for option in sorted(grasps(name), key=lambda option: option.blockers.bit_count()):
            if deadline.is_over:
                return False
            if option.blockers & waiting:
                continue
            kept, kept_order = dict(chosen), list(order)
            blockers = [blocker for blocker in scene.names_of(option.blockers) if blocker not in chosen]
            if all(blocker in chosen or commit(blocker, waiting) for blocker in blockers):
                chosen[name] = option
                order.append(name)
                return True
            chosen.clear()
            chosen.update(kept)
            order[:] = kept_order
        return False

    if commit(target, 0):
        return Commitments(target, tuple(order[:-1]), MappingProxyType(chosen))
    if deadline.is_over:
        return NoCommitment(Cause.TIME_LIMIT, (target,))
    return NoCommitment(Cause.NO_SELF_CLEARABLE_SET if grasps(target) else Cause.UNREACHABLE, (target,))


def _smallest(grasps: Grasps, scene: Scene, target: str, deadline: Deadline) -> Commitments | NoCommitment:
    """Find the smallest self-clearable set, with the best grasp of each object among those free at its turn."""

    def masks(name: str) -> list[int]:
        return [option.blockers for option in grasps(name)]

    found = next(self_clearable_sets(masks, target, scene.names, deadline=deadline))
    if found.count is None:
        return NoCommitment(Cause(found.cause), (target,))
    chosen: dict[str, GraspCandidate] = {}
    for name in (*found.objects, target):
        gone = scene.mask(chosen)
        free = [option for option in grasps(name) if not option.blockers & ~gone]
        chosen[name] = max(free, key=lambda option: option.quality)
    return Commitments(target, found.objects, MappingProxyType(chosen))
