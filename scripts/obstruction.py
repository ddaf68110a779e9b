"""Agreement of the geometric test for obstructed targets with the planner's minimum number of clearances.

    python scripts/obstruction.py
    python scripts/obstruction.py --drawn --seed 7000000
    python scripts/obstruction.py --drawn --seed 7000000 --robot pr2 --share 0.08

Prints the confusion table of the documentation of suites; or with `--drawn` how many of the scenes that
`obstructed=True` draws have no plan with side grasps, and what their resets cost.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
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
DRAWN = {("paper", 15): 500, ("paper", 25): 500, ("paper", 40): 500, ("dense", 25): 200, ("shelf", 16): 200}
"""Numbers of scenes that are drawn with `obstructed=True`."""
HEAD_DRAWN = ("scenes", "number", "without a plan", "nothing to clear", "reset [ms]", "slowest [ms]")


class Drawn(NamedTuple):
    """What the planner says of a scene drawn with `obstructed=True`, and the CPU time [s] of its reset."""

    has_plan: bool
    is_free: bool
    reset_time: float


def main(seed: int = 600_000, workers: int = 2, share: float = 1.0, drawn: bool = False, robot: str = "fetch") -> None:
    """Ask test and planner about scenes with consecutive seeds, and print the table.

    Args:
        seed: First seed of every set of scenes.
        workers: Number of processes.
        share: Share of the scenes that is looked at, the first ones of each set.
        drawn: Scenes with obstructed targets in place of random ones.
        robot: Name of the robot.
    """
    if drawn:
        print(markdown_table(HEAD_DRAWN, list(drawn_rows(robot, seed, workers, share))), end="")
        return
    counts = {
        name: Counter[tuple[bool, bool]](found) for name, found in ask(compare, SCENES, robot, seed, workers, share)
    }
    counts["all"] = sum(counts.values(), Counter())
    rows = []
    for name, found in counts.items():
        cells = [found[True, True], found[False, False], found[True, False], found[False, True]]
        agreement = (found[True, True] + found[False, False]) / max(found.total(), 1)
        rows.append((name, *map(str, (found.total(), *cells)), f"{agreement:.1%}"))
    print(markdown_table(HEAD, rows), end="")


def drawn_rows(robot: str, seed: int, workers: int, share: float) -> Iterator[tuple[str, ...]]:
    """The rows of the table of drawn scenes."""
    for name, found in ask(look_at_drawn, DRAWN, robot, seed, workers, share):
        times = 1000 * np.array([one.reset_time for one in found])
        counts = len(found), sum(not one.has_plan for one in found), sum(one.is_free for one in found)
        yield name, *map(str, counts), f"{times.mean():.1f}", f"{times.max():.1f}"


def ask(
    function: Callable[[tuple[str, str, int, int]], Any],
    scenes: dict[tuple[str, int], int],
    robot: str,
    seed: int,
    workers: int,
    share: float,
) -> Iterator[tuple[str, list[Any]]]:
    """The name of each set of scenes, and what a function says of them."""
    jobs = [(robot, layout, n, seed + k) for (layout, n), count in scenes.items() for k in range(round(share * count))]
    answers: dict[tuple[str, int], list[Any]] = {key: [] for key in scenes}
    for (_, layout, n, number), result in progress_bar(
        run_jobs(function, jobs, workers), total=len(jobs), unit="scene"
    ):
        if isinstance(result, Crash | Killed):
            raise RuntimeError(f"layout {layout}, {n} objects, seed {number}: {result}")
        answers[layout, n].append(result)
    for (layout, n), found in answers.items():
        yield f"{layout}, {n} objects", found


def compare(job: tuple[str, str, int, int]) -> tuple[bool, bool]:
    """Whether the target is obstructed by the test, and by the planner; one out of reach is not obstructed.

    Args:
        job: robot, layout, number of objects, seed.
    """
    name, layout, objects, seed = job
    env = make_env(name, layout, objects)
    _, info = env.reset(seed=seed)
    inner: Any = env.unwrapped
    robot = inner.robot
    blockers = count_blockers(side_approaches(robot.full_name), inner.layout, inner.world.scene, robot.max_opening)
    scene = Scene.from_mujoco(inner.model, inner.data, robot)
    floor = Planner(robot, grasps="side").clearance_floor(scene, info["target"])
    return bool(blockers[inner.target_slot] > 0), floor.count != 0 and floor.cause != Cause.UNREACHABLE


def look_at_drawn(job: tuple[str, str, int, int]) -> Drawn:
    """What the planner says of the scene that is drawn with an obstructed target.

    Args:
        job: robot, layout, number of objects, seed.
    """
    name, layout, objects, seed = job
    env = make_env(name, layout, objects)
    start = time.process_time()
    _, info = env.reset(seed=seed, options={"obstructed": True})
    reset_time = time.process_time() - start
    inner: Any = env.unwrapped
    scene = Scene.from_mujoco(inner.model, inner.data, inner.robot)
    floor = Planner(inner.robot, grasps="side").clearance_floor(scene, info["target"])
    return Drawn(floor.count is not None, floor.count == 0, reset_time)


@cache
def make_env(robot: str, layout: str, objects: int) -> gym.Env[Any, Any]:
    """The environment of a set of scenes, kept in each process; its first reset, which reads tables, is done."""
    env = gym.make("clutter_env/Retrieve-o15-v0", robot=robot, layout=layout, num_objects=objects)
    env.reset(seed=0, options={"obstructed": True})
    return env


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
