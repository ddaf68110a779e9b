"""Agreement of the geometric test for obstructed targets with the planner's minimum number of clearances.

    python scripts/obstruction.py

Prints the confusion table of the documentation of suites.
"""

from __future__ import annotations

from collections import Counter
from functools import cache
from typing import Any, NamedTuple

import gymnasium as gym
import tyro

import clutter_env  # noqa: F401  registers the environments
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import markdown_table
from clutter_env.scene.obstruction import count_blockers, side_approaches
from planners import Cause, Planner, Scene


class SceneSet(NamedTuple):
    """Scenes of one layout with a number of objects; the targets are drawn at random."""

    layout: str
    objects: int
    scenes: int


SCENE_SETS = (
    SceneSet("paper", 15, 700),
    SceneSet("paper", 25, 400),
    SceneSet("paper", 40, 300),
    SceneSet("dense", 25, 200),
    SceneSet("wide", 25, 200),
    SceneSet("island", 25, 200),
    SceneSet("shelf", 10, 200),
)
"""2,200 scenes."""


class Job(NamedTuple):
    """One scene."""

    scene_set: SceneSet
    seed: int


def main(seed: int = 600_000, workers: int = 2) -> None:
    """Compare test and planner on scenes with consecutive seeds, and print the table.

    Args:
        seed: First seed of every set of scenes.
        workers: Number of processes.
    """
    counts = agreement(seed, workers)
    counts["all"] = sum(counts.values(), Counter())
    head = ("scenes", "number", "both: obstructed", "both: not", "test only", "planner only", "agreement")
    rows = []
    for name, found in counts.items():
        cells = [found[True, True], found[False, False], found[True, False], found[False, True]]
        rows.append((name, *map(str, (found.total(), *cells)), f"{share(found):.1%}"))
    print(markdown_table(head, rows), end="")


def agreement(
    first_seed: int, workers: int, scene_sets: tuple[SceneSet, ...] = SCENE_SETS
) -> dict[str, Counter[tuple[bool, bool]]]:
    """Numbers of scenes by what the test says and what the planner finds, for each set of scenes.

    Raises:
        RuntimeError: a worker failed.
    """
    counts = {f"{one.layout}, {one.objects} objects": Counter[tuple[bool, bool]]() for one in scene_sets}
    jobs = [Job(one, first_seed + number) for one in scene_sets for number in range(one.scenes)]
    for job, result in progress_bar(run_jobs(compare, jobs, workers), total=len(jobs), unit="scene"):
        if isinstance(result, Crash | Killed):
            raise RuntimeError(f"{job}: {result}")
        counts[f"{job.scene_set.layout}, {job.scene_set.objects} objects"][result] += 1
    return counts


def share(found: Counter[tuple[bool, bool]]) -> float:
    """Share of the scenes on which test and planner agree."""
    return (found[True, True] + found[False, False]) / found.total()


def compare(job: Job) -> tuple[bool, bool]:
    """Whether the target is obstructed by the test, and by the planner; one out of reach is not obstructed."""
    env = make_env(job.scene_set)
    _, info = env.reset(seed=job.seed)
    inner: Any = env.unwrapped
    robot = inner.robot
    blockers = count_blockers(side_approaches(robot.full_name), inner.layout, inner.world.scene, robot.max_opening)
    scene = Scene.from_mujoco(inner.model, inner.data, robot)
    floor = Planner(robot, grasps="side").clearance_floor(scene, info["target"])
    return bool(blockers[inner.target_slot] > 0), floor.count != 0 and floor.cause != Cause.UNREACHABLE


@cache
def make_env(scene_set: SceneSet) -> gym.Env[Any, Any]:
    """The environment of a set of scenes, kept in each process."""
    return gym.make("clutter_env/Retrieve-o15-v0", layout=scene_set.layout, num_objects=scene_set.objects)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
