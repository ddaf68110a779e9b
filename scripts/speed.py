"""Steps over their physics, and resets over those of Gymnasium-Robotics' FetchPickAndPlace, on a machine of any load.

    python -m scripts.speed

Every episode is played several times, and every step has the least of its times: the simulation is deterministic, and
other processes make a time longer, never shorter. Of resets to the same seeds alike; the two kinds take turns. The peer
must be installed: `pip install gymnasium-robotics`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from itertools import product, repeat
from typing import Any

import gymnasium as gym
import numpy as np
import tyro

from clutter_env.bridges.fetch_tasks import make
from clutter_env.cli.benchmark import timed_physics
from clutter_env.config import CONTROL_MODES
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import markdown_table
from scripts.soak import blind_grasps


def main(repeats: int = 10, steps: int = 300, resets: int = 60, objects: int = 20, seed: int = 0) -> None:
    """Measure and print.

    Args:
        repeats: of every episode and every reset.
        steps: control steps of an episode.
        resets: seeds of resets.
        objects: their number in this package's scenes.
        seed: Random seed of scene and actions.
    """
    envs = {mode: RetrieveEnv(num_objects=objects, control_mode=mode) for mode in CONTROL_MODES}
    rows = []
    for mode, motion in progress_bar(list(product(envs, MOTIONS)), desc="measuring", unit="episode"):
        own_s, physics_s = step_times(envs[mode], motion, steps, repeats, seed)
        rows.append(
            [f"step, {mode}, {motion}", f"{own_s * 1e6:.0f}", f"{physics_s * 1e6:.0f}", f"{own_s / physics_s:.2f}"]
        )
    own_s, peer_s = reset_times(envs["joint"], make("FetchPickAndPlace-v4"), resets, repeats)
    rows.append(["reset", f"{own_s * 1e6:.0f}", f"{peer_s * 1e6:.0f}", f"{own_s / peer_s:.2f}"])
    print(markdown_table(["", "µs", "physics alone, or the peer's reset: µs", "ratio"], rows), end="")


def step_times(env: RetrieveEnv, motion: str, steps: int, repeats: int, seed: int) -> tuple[float, float]:
    """Least time [s] of a step, and of the physics in it, in the mean of an episode."""
    rest, physics = np.full((2, steps), np.inf)
    with timed_physics(time.perf_counter) as timed:
        for _ in range(repeats):
            env.reset(seed=seed)
            moves = MOTIONS[motion](env, np.random.default_rng(seed))
            for step in range(steps):
                action, timed.spent_s = next(moves), 0.0
                start = time.perf_counter()
                env.step(action)
                rest[step] = min(rest[step], time.perf_counter() - start - timed.spent_s)
                physics[step] = min(physics[step], timed.spent_s)
    return float((rest + physics).mean()), float(physics.mean())


def reset_times(env: gym.Env, peer: gym.Env, resets: int, repeats: int) -> tuple[float, float]:
    """Least time [s] of a reset of each environment, in the mean of the seeds."""
    least = np.full((2, resets), np.inf)
    for _, seed in product(range(repeats), range(resets)):
        start = time.perf_counter()
        env.reset(seed=seed)
        between = time.perf_counter()
        peer.reset(seed=seed)
        least[:, seed] = np.minimum(least[:, seed], (between - start, time.perf_counter() - between))
    own_s, peer_s = least.mean(axis=1).tolist()
    return own_s, peer_s


def random_actions(env: RetrieveEnv, rng: np.random.Generator) -> Iterator[Any]:
    """Another random action in every step, as `clutter-env benchmark` does."""
    while True:
        yield rng.uniform(-1, 1, env.action_size).astype(np.float32)


def no_motion(env: RetrieveEnv, _: np.random.Generator) -> Iterator[Any]:
    """The robot at rest, away from the table."""
    return repeat(np.zeros(env.action_size))


MOTIONS: Mapping[str, Callable[[RetrieveEnv, np.random.Generator], Iterator[Any]]] = {
    "random": random_actions,
    "blind grasps": blind_grasps,
    "at rest": no_motion,
}


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
