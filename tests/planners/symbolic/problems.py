"""Task problems for tests."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from planners.symbolic.problem import GRIPPER, TaskProblem
from planners.symbolic.transitions import GraspObstructed, initial_state, update_from_error


def names(count: int) -> list[str]:
    return [f"object_{i:02d}" for i in range(count)]


def obstruction_problem(
    target: str,
    blockers: Mapping[str, Collection[str]],
    *,
    objects: Collection[str] = (),
    held: str = "",
    held_obstructs: str = "",
    grippers: tuple[str, ...] = (GRIPPER,),
) -> TaskProblem:
    """The problem in which each object's grasp is obstructed by its `blockers`; `held` is in the first gripper."""
    mentioned = {target, *objects, *blockers, *(name for some in blockers.values() for name in some)} | {held} - {""}
    state = initial_state(sorted(mentioned), {grippers[0]: held} if held else {}, grippers, held_obstructs)
    for name in sorted(set(blockers) - {held}):
        state = update_from_error(state, GraspObstructed(name, frozenset(blockers[name]) - {held}))
    return TaskProblem(state, target)


def random_problem(rng: np.random.Generator, largest: int = 8) -> TaskProblem:
    objects = names(int(rng.integers(1, largest)))
    density = rng.choice([0.1, 0.2, 0.35])
    blockers = {a: {b for b in objects if a != b and rng.random() < density} for a in objects}
    held = objects[-1] if len(objects) > 1 and rng.random() < 0.25 else ""
    blockers.pop(held, None)
    obstructs = objects[0] if held and rng.random() < 0.5 else ""
    return obstruction_problem(objects[0], blockers, objects=names(12), held=held, held_obstructs=obstructs)
