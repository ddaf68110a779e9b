"""Steps over their physics, and resets over those of Gymnasium-Robotics' FetchPickAndPlace, in turn in one process.

    python scripts/speed.py --rounds 5

CPU times; every figure is a ratio of times taken one after the other, and the table has the median of the rounds and
their range. Gymnasium-Robotics must be installed: `pip install gymnasium-robotics`.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from itertools import repeat
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import tyro

from clutter_env.cli.benchmark import time_steps
from clutter_env.config import CONTROL_MODES
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import markdown_table
from scripts.soak import blind_grasps

MOTIONS = ("random", "blind grasps", "at rest")


def main(rounds: int = 5, steps: int = 600, resets: int = 100, objects: int = 20, seed: int = 0) -> None:
    """Measure and print.

    Args:
        rounds: of all measurements.
        steps: control steps of each motion and control mode in a round.
        resets: of each environment in a round, in turn.
        objects: their number in this package's scenes.
        seed: Random seed of scenes and actions.
    """
    envs = {mode: RetrieveEnv(num_objects=objects, control_mode=mode) for mode in CONTROL_MODES}
    peer = fetch_pick_and_place()
    ratios: dict[str, list[float]] = {}
    for turn in progress_bar(range(rounds), desc="measuring", unit="round"):
        for motion in MOTIONS:
            for mode, env in envs.items():
                first = seed + turn * steps
                env.reset(seed=first)
                times = time_steps(env, steps, first, actions(env, motion, first))
                ratios.setdefault(f"step / physics, {motion}, {mode}", []).append(times.step_s / times.physics_s)
        own_s, peer_s = (np.array(column) for column in zip(*(reset_times(envs["joint"], peer, resets)), strict=True))
        ratios.setdefault("reset / reset of FetchPickAndPlace", []).append(own_s.sum() / peer_s.sum())
    rows = [[name, *(f"{value:.2f}" for value in (np.median(r), min(r), max(r)))] for name, r in ratios.items()]
    print(markdown_table(["ratio of CPU times", "median", "least", "most"], rows), end="")


def actions(env: RetrieveEnv, motion: str, seed: int) -> Iterator[Any] | None:
    """The actions of a motion, None for random ones."""
    if motion == "random":
        return None
    return repeat(np.zeros(env.action_size)) if motion == "at rest" else blind_grasps(env, np.random.default_rng(seed))


def reset_times(env: gym.Env, peer: gym.Env, resets: int) -> Iterator[tuple[float, float]]:
    """CPU times [s] of one reset each, in turn."""
    for seed in range(resets):
        start = time.process_time()
        env.reset(seed=seed)
        between = time.process_time()
        peer.reset(seed=seed)
        yield between - start, time.process_time() - between


def fetch_pick_and_place() -> gym.Env:
    """Gymnasium-Robotics' environment, whose comparison of joint types does not hold with MuJoCo 4's enumerations."""
    import gymnasium_robotics
    from gymnasium_robotics.utils import mujoco_utils

    kinds = SimpleNamespace(**{name: int(kind) for name, kind in mujoco.mjtJoint.__members__.items()})
    mujoco_utils.mujoco = SimpleNamespace(**{**vars(mujoco), "mjtJoint": kinds})
    gym.register_envs(gymnasium_robotics)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return gym.make("FetchPickAndPlace-v4")


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
