"""Steps a second of several environments: one after the other, in threads, in processes; on a quiet machine.

python scripts/vector_speed.py --num-envs 4
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import gymnasium as gym
import numpy as np
import tyro

import clutter_env  # noqa: F401  registers the environments
from clutter_env.reporting.tables import markdown_table


def main(num_envs: int = 4, workers: int = 2, objects: int = 15, steps: int = 300, repeats: int = 3) -> None:
    """Measure and print, the best of several runs each.

    Args:
        num_envs: Environments.
        workers: Threads among which they are shared out.
        objects: In each.
        steps: Control steps of each in a run.
        repeats: Runs.
    """
    env_id = f"clutter_env/Retrieve-o{objects}-v0"
    envs = [gym.make(env_id) for _ in range(num_envs)]
    actions = (
        np.random.default_rng(0)
        .uniform(-1, 1, (steps, num_envs, *(envs[0].action_space.shape or ())))
        .astype(np.float32)
    )

    def step(some: range, at: int) -> None:
        for index in some:
            envs[index].step(actions[at, index])

    def measure(run: Callable[[int], object], reset: Callable[[], object]) -> float:
        best = np.inf
        for _ in range(repeats):
            reset()
            begun = time.perf_counter()
            for at in range(steps):
                run(at)
            best = min(best, time.perf_counter() - begun)
        return num_envs * steps / best

    def reset_all() -> None:
        for index, env in enumerate(envs):
            env.reset(seed=index)

    shares = [range(first, num_envs, workers) for first in range(workers)]
    rates = {"one after the other": measure(lambda at: step(range(num_envs), at), reset_all)}
    with ThreadPoolExecutor(workers) as pool:
        rates[f"{workers} threads"] = measure(lambda at: list(pool.map(step, shares, [at] * workers)), reset_all)
    processes = gym.make_vec(env_id, num_envs, vectorization_mode="async")
    rates[f"{num_envs} processes (async)"] = measure(
        lambda at: processes.step(actions[at]), lambda: processes.reset(seed=0)
    )
    processes.close()
    one = next(iter(rates.values()))
    print(
        markdown_table(["", "steps / s", "ratio"], [[k, f"{v:.0f}", f"{v / one:.2f}"] for k, v in rates.items()]),
        end="",
    )


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
