"""Lower bounds of the suites that are others today, and the grasps and base poses on which they depend.

    python scripts/bound_catalogues.py
    python scripts/bound_catalogues.py --names deep-25-v2 --seeds 2085241 --physics
    python scripts/bound_catalogues.py --names side-25-v3 --scenes 20 --finer

The bounds of every scene of a suite are worked out again, for the grasp sets "side" and "all". A row for each one that
differs from the suite's file: the bound there and today; without the families of "all" that hold an object 10 mm short
of its axis; with 40 base poses looked at for each gripper pose, where the planner looks at 3, and at 8 where these give
no grasp. Beside these the clearances of plans, as the planner makes them and with the 40 base poses. With `--physics`,
the expert plays both. With `--finer` there is a row for each bound that is lower with the 40 base poses, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import tyro

import clutter_env
from clutter_env.reporting.progress import progress_bar
from clutter_env.suites import GRASPS, SPLITS, SuiteScene
from planners import Scene, Solution, TampExpert, clearance_floor, solve, warmup
from planners.grasping import candidates
from planners.grasping.families import GRASP_SETS, GraspFamily

CHANGED = ("all-25-v3", "deep-15-v2", "deep-25-v2", "deep-shelf-12-v2", "dense-25-v3")
MANY = (40,)
"""Base poses for each gripper pose, in place of `candidates._BASES`."""
COLUMNS = ("suite", "seed", "grasps", "file", "today", "without 10 mm", "40 bases", "plan", "plan, 40 bases")


@dataclass(frozen=True)
class Arguments:
    """Which scenes."""

    names: tuple[str, ...] = CHANGED
    """Suites of Retrieve."""
    seeds: tuple[int, ...] = ()
    """Scenes of these seeds alone; without any, all of the suites."""
    scenes: int = 0
    """The first test scenes of each suite alone; 0 for both splits."""
    physics: bool = False
    """Play the plans, too."""
    finer: bool = False
    """Rows also for bounds that only more base poses make lower."""


def main(arguments: Arguments) -> None:
    """Print the rows, and how many scenes were compared."""
    warmup()
    wanted = [
        scene
        for name in arguments.names
        for split in (SPLITS[:1] if arguments.scenes else SPLITS)
        for scene in clutter_env.suite(name).split(split)[: arguments.scenes or None]
        if not arguments.seeds or scene.seed in arguments.seeds
    ]
    columns = (*COLUMNS, *(("played", "played, 40 bases") if arguments.physics else ()))
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|")
    number = 0
    for scene in progress_bar(wanted):
        for cells in rows(scene, arguments.physics, arguments.finer):
            print(f"| {' | '.join(map(str, cells))} |", flush=True)
            number += 1
    print(f"{len(wanted)} scenes, {number} rows")


def rows(scene: SuiteScene, physics: bool = False, finer: bool = False) -> Iterator[tuple[Any, ...]]:
    """The cells of `COLUMNS` for each grasp set with another bound, and what became of the plans when played."""
    with closing(scene.make()) as env:
        _, info = scene.reset(env)
        inner: Any = env.unwrapped
        read, target = Scene.from_mujoco(inner.model, inner.data, inner.robot), info["target"]
        for grasps in GRASPS:
            there, today = scene.floor(grasps).count, clearance_floor(read, target, grasps=grasps).count
            more = bound_of_many(read, target, grasps) if finer or there != today else today
            if there == today == more:
                continue
            fewer = tuple(one for one in GRASP_SETS[grasps] if not is_short_of_axis(one))
            before = clearance_floor(read, target, grasps=fewer).count
            plans = [cleared(read, target, grasps, how) for how in (nullcontext(), many_bases())]
            played = [play(scene, env, grasps, how) for how in (nullcontext(), many_bases())] if physics else []
            yield (scene.suite, scene.seed, grasps, there, today, before, more, *plans, *played)


def bound_of_many(scene: Scene, target: str, grasps: str) -> int | None:
    """The bound with more base poses."""
    with many_bases():
        return clearance_floor(scene, target, grasps=grasps).count


def is_short_of_axis(family: object) -> bool:
    """Whether a family holds objects short of their axis."""
    return isinstance(family, GraspFamily) and bool(family.axis_offset)


def many_bases() -> AbstractContextManager[Any]:
    """More base poses for each gripper pose, as long as it lasts."""
    return patch.object(candidates, "_BASES", MANY)


def cleared(scene: Scene, target: str, grasps: str, how: AbstractContextManager[Any]) -> int | str:
    """Clearances of a plan, or why there is none."""
    with how:
        found = solve(scene, target, grasps=grasps)
    return len(found.clearances) if isinstance(found, Solution) else str(found.cause)


def play(scene: SuiteScene, env: Any, grasps: str, how: AbstractContextManager[Any]) -> str:
    """What the expert's episode came to: "clean" for a success, and the objects that it cleared."""
    _, info = scene.reset(env)
    is_clean, is_over = False, False
    with how:
        expert = TampExpert(env, grasps=grasps)
        expert.reset()
        while not (expert.done or is_over):
            _, _, terminated, truncated, info = env.step(expert.act())
            is_clean |= bool(info["is_success"])
            is_over = terminated or truncated
    return f"{'clean' if is_clean else 'not clean'}, {info['num_cleared']}"


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
