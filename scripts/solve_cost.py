"""Plans of this checkout beside those of another one, such as a version before: CPU times, in turns.

    git worktree add ../before 0f39b50b
    python scripts/solve_cost.py ../before --objects 40 --scenes 40
    python scripts/solve_cost.py ../before --task sort --objects 20 --scenes 20

Each checkout has a process of its own, with kernels that it has compiled, and makes the scenes with its own
environment. Both plan for the same seeds in turns, and each plan has the least of its times.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import tyro

from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import markdown_table

_HERE = Path(__file__).resolve().parents[1]
_WORKER = """
import json, sys, time
import gymnasium as gym
import clutter_env
from planners import Planner, Scene, Solution, warmup

task, objects, grasps = sys.argv[1:]
warmup()
name = f"clutter_env/Rearrange-o{objects}-v0" if task else f"clutter_env/Retrieve-o{objects}-v0"
for line in sys.stdin:
    seed = json.loads(line)
    env = gym.make(name, task=task) if task else gym.make(name, obstructed=True)
    _, info = env.reset(seed=seed)
    world = env.unwrapped
    scene, goal = Scene.from_mujoco(world.model, world.data, world.robot), world.goal if task else info["target"]
    env.close()
    start = time.process_time()
    found = Planner(scene.robot, grasps=grasps).solve(scene, goal)
    spent = time.process_time() - start
    print(json.dumps([spent, found.picks if isinstance(found, Solution) else 0]), flush=True)
"""
"""Plans for the seeds that it is asked for, and prints the time [s] and the picks of each plan, 0 for none."""


class Checkout:
    """A process that plans with the code of one checkout."""

    def __init__(self, folder: Path, task: str, objects: int, grasps: str) -> None:
        settings = {**os.environ, "PYTHONPATH": str(folder.resolve()), "OMP_NUM_THREADS": "1"}
        command = [sys.executable, "-c", _WORKER, task, str(objects), grasps]
        self._process = subprocess.Popen(
            command, cwd=folder, env=settings, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def solve(self, seed: int) -> tuple[float, int]:
        """CPU time [s] and picks of a plan."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(seed) + "\n")
        self._process.stdin.flush()
        spent, picks = json.loads(self._process.stdout.readline())
        return spent, picks

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def main(
    other: tyro.conf.Positional[Path],
    task: str = "",
    objects: int = 40,
    scenes: int = 40,
    seed: int = 300_000,
    grasps: str = "",
    repeats: int = 2,
) -> None:
    """Measure and print.

    Args:
        other: folder of the other checkout.
        task: of Rearrange; without one, an obstructed target is taken.
        objects: their number.
        scenes: their number.
        seed: of the first scene.
        grasps: the grasp set, by default "side" for a target and "all" for a task.
        repeats: of every plan.
    """
    chosen = grasps or ("all" if task else "side")
    checkouts = [Checkout(folder, task, objects, chosen) for folder in (other, _HERE)]
    least, picks = np.full((2, scenes), np.inf), np.zeros((2, scenes), int)
    for row in progress_bar(range(scenes), desc="planning", unit="scene"):
        for repeat in range(repeats):
            for one in (0, 1) if repeat % 2 else (1, 0):
                spent, picks[one, row] = checkouts[one].solve(seed + row)
                least[one, row] = min(least[one, row], spent)
    for checkout in checkouts:
        checkout.close()
    (theirs, ours), ratios = least, least[1] / least[0]
    rows = [
        [what, *(f"{take(one):.2f}" for one in (theirs, ours)), f"{take(ours) / take(theirs):.2f}"]
        for what, take in (("median", np.median), ("95%", _high), ("largest", np.max), ("sum", np.sum))
    ]
    print(markdown_table(["CPU time of a plan", "other, s", "here, s", "ratio"], rows), end="")
    print(
        f"ratios of the scenes: median {np.median(ratios):.2f}, from {ratios.min():.2f} to {ratios.max():.2f}; ", end=""
    )
    print(f"planned: {(picks[0] > 0).sum()} and {(picks[1] > 0).sum()} of {scenes}, ", end="")
    print(f"picks {picks[0].sum()} and {picks[1].sum()}, the same in {(picks[0] == picks[1]).sum()}")


def _high(times: np.ndarray) -> float:
    return float(np.quantile(times, 0.95))


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
