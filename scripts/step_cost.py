"""Steps of this checkout beside those of another one, such as a version before: CPU times, in turns.

    git worktree add ../before 0f39b50b
    python scripts/step_cost.py ../before

Each checkout has a process of its own. Both play the same episodes, several times in turns, and every step has the
least of its times: the simulation is deterministic, and other processes make a time longer, never shorter. Two versions
with another physics meet other contacts in an episode, so one alone says little: the range is that of the episodes.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import numpy as np
import tyro
from numpy.typing import NDArray

from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import markdown_table

_HERE = Path(__file__).resolve().parents[1]
_MODES, _MOTIONS = ("joint", "ee"), ("sampled", "at rest")
_WORKER = """
import json, sys, time
import gymnasium as gym
import numpy as np
import clutter_env

mode, objects, steps = sys.argv[1], sys.argv[2], int(sys.argv[3])
env = gym.make(f"clutter_env/Retrieve-o{objects}-v0", control_mode=mode).unwrapped
for line in sys.stdin:
    motion, seed = json.loads(line)
    env.action_space.seed(seed)
    actions = np.array([env.action_space.sample() for _ in range(steps)])
    if motion == "at rest":
        actions[:] = 0.0
    env.reset(seed=seed)
    times = []
    for action in actions:
        start = time.process_time()
        env.step(action)
        times.append(time.process_time() - start)
    print(json.dumps(times), flush=True)
"""
"""Plays the episodes that it is asked for, and prints the time [s] of each step."""


class Checkout:
    """A process that plays episodes with the code of one checkout."""

    def __init__(self, folder: Path, mode: str, objects: int, steps: int) -> None:
        settings = {**os.environ, "PYTHONPATH": str(folder.resolve()), "OMP_NUM_THREADS": "1"}
        command = [sys.executable, "-c", _WORKER, mode, str(objects), str(steps)]
        self._process = subprocess.Popen(
            command, cwd=folder, env=settings, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def play(self, motion: str, seed: int) -> NDArray[np.float64]:
        """CPU time [s] of each step of an episode."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([motion, seed]) + "\n")
        self._process.stdin.flush()
        return np.array(json.loads(self._process.stdout.readline()))

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def main(
    other: tyro.conf.Positional[Path], repeats: int = 4, steps: int = 250, episodes: int = 20, objects: int = 15
) -> None:
    """Measure and print.

    Args:
        other: folder of the other checkout.
        repeats: of every episode.
        steps: control steps of an episode.
        episodes: of random actions; at rest a fifth of them.
        objects: their number.
    """
    rows = []
    for mode in _MODES:
        checkouts = [Checkout(folder, mode, objects, steps) for folder in (other, _HERE)]
        for motion in _MOTIONS:
            seeds = range(max(episodes // 5, 1) if motion == "at rest" else episodes)
            least = np.full((2, len(seeds), steps), np.inf)
            for seed, repeat in progress_bar(
                list(product(seeds, range(repeats))), desc=f"{mode}, {motion}", unit="turn"
            ):
                for one in (0, 1) if repeat % 2 else (1, 0):
                    least[one, seed] = np.minimum(least[one, seed], checkouts[one].play(motion, seed))
            theirs, ours = least.mean(axis=(1, 2)) * 1e3
            ratios = least[1].mean(axis=1) / least[0].mean(axis=1)
            spread = f"{ratios.min():.2f} to {ratios.max():.2f}"
            middle = f"{np.median(ratios):.2f}"
            rows.append([mode, motion, f"{theirs:.3f}", f"{ours:.3f}", f"{ours / theirs:.2f}", middle, spread])
        for checkout in checkouts:
            checkout.close()
    header = ["control", "actions", "other, ms", "here, ms", "ratio", "median of the episodes", "range of the episodes"]
    print(markdown_table(header, rows), end="")


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
