"""Agreement of the geometric test for obstructed targets with the planner's minimum number of clearances.

    python scripts/obstruction.py

Prints the confusion table of the documentation of suites.
"""

from __future__ import annotations

from collections import Counter
from functools import cache
from typing import Any

import gymnasium as gym
import tyro

import clutter_env  # noqa: F401  registers the environments
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import markdown_table
from clutter_env.scene.obstruction import count_blockers, side_approaches
from planners import Cause, Planner, Scene

SCENES = {
    ("paper", 15): 700,
    ("paper", 25): 400,
    ("paper", 40): 300,
    ("dense", 25): 200,
    ("wide", 25): 200,
    ("island", 25): 200,
    ("shelf", 10): 200,
}
"""Numbers of scenes, 2,200 in all, by layout and number of objects; the targets are drawn at random."""
HEAD = ("scenes", "number", "both: obstructed", "both: not", "test only", "planner only", "agreement")


def main(seed: int = 600_000, workers: int = 2, share: float = 1.0) -> None:
    """Compare test and planner on scenes with consecutive seeds, and print the table.

    Args:
        seed: First seed of every set of scenes.
        workers: Number of processes.
        share: Share of the scenes that is compared, the first ones of each set.
    """
    jobs = [(layout, n, seed + k) for (layout, n), count in SCENES.items() for k in range(round(share * count))]
    counts = {f"{layout}, {n} objects": Counter[tuple[bool, bool]]() for layout, n in SCENES}
    for (layout, n, number), result in progress_bar(run_jobs(compare, jobs, workers), total=len(jobs), unit="scene"):
        if isinstance(result, Crash | Killed):
            raise RuntimeError(f"layout {layout}, {n} objects, seed {number}: {result}")
        counts[f"{layout}, {n} objects"][result] += 1
    counts["all"] = sum(counts.values(), Counter())
    rows = []
    for name, found in counts.items():
        cells = [found[True, True], found[False, False], found[True, False], found[False, True]]
        agreement = (found[True, True] + found[False, False]) / max(found.total(), 1)
        rows.append((name, *map(str, (found.total(), *cells)), f"{agreement:.1%}"))
    print(markdown_table(HEAD, rows), end="")


def compare(job: tuple[str, int, int]) -> tuple[bool, bool]:
    """Whether the target is obstructed by the test, and by the planner; one out of reach is not obstructed.

    Args:
        job: layout, number of objects, seed.
    """
    layout, objects, seed = job
    env = make_env(layout, objects)
    _, info = env.reset(seed=seed)
    inner: Any = env.unwrapped
    robot = inner.robot
    blockers = count_blockers(side_approaches(robot.full_name), inner.layout, inner.world.scene, robot.max_opening)
    scene = Scene.from_mujoco(inner.model, inner.data, robot)
    floor = Planner(robot, grasps="side").clearance_floor(scene, info["target"])
    return bool(blockers[inner.target_slot] > 0), floor.count != 0 and floor.cause != Cause.UNREACHABLE


@cache
def make_env(layout: str, objects: int) -> gym.Env[Any, Any]:
    """The environment of a set of scenes, kept in each process."""
    return gym.make("clutter_env/Retrieve-o15-v0", layout=layout, num_objects=objects)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
