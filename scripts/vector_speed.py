"""Steps a second of several environments: one after the other, in threads, in processes; on a quiet machine.

python scripts/vector_speed.py --num-envs 4
python scripts/vector_speed.py --num-envs 8 --env-id FetchPickAndPlaceDense-v4

CPU times are those of this process: they say what a step costs where others use the machine too.
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


def main(
    num_envs: int = 4,
    workers: int = 2,
    objects: int = 15,
    env_id: str = "",
    steps: int = 300,
    repeats: int = 3,
    processes: bool = True,
) -> None:
    """Measure and print, the best of several runs each.

    Args:
        num_envs: Environments.
        workers: Threads among which they are shared out.
        objects: In each.
        env_id: Another environment, also of Gymnasium-Robotics; empty for Retrieve.
        steps: Control steps of each in a run.
        repeats: Runs.
        processes: Whether they are also measured with a process for each of them.
    """
    env_id = env_id or f"clutter_env/Retrieve-o{objects}-v0"
    envs = [gym.make(env_id) for _ in range(num_envs)]
    actions = (
        np.random.default_rng(0)
        .uniform(-1, 1, (steps, num_envs, *(envs[0].action_space.shape or ())))
        .astype(np.float32)
    )

    def step(some: range, at: int) -> None:
        for index in some:
            *_, terminated, truncated, _ = envs[index].step(actions[at, index])
            if terminated or truncated:
                envs[index].reset()

    def measure(run: Callable[[int], object], reset: Callable[[], object]) -> tuple[float, float]:
        """Steps a second, and CPU time [ms] of a step."""
        best = best_cpu = np.inf
        for _ in range(repeats):
            reset()
            begun, begun_cpu = time.perf_counter(), time.process_time()
            for at in range(steps):
                run(at)
            best = min(best, time.perf_counter() - begun)
            best_cpu = min(best_cpu, time.process_time() - begun_cpu)
        return num_envs * steps / best, 1e3 * best_cpu / (num_envs * steps)

    def reset_all() -> None:
        for index, env in enumerate(envs):
            env.reset(seed=index)

    shares = [range(first, num_envs, workers) for first in range(workers)]
    rates = {"one after the other": measure(lambda at: step(range(num_envs), at), reset_all)}
    with ThreadPoolExecutor(workers) as pool:
        rates[f"{workers} threads"] = measure(lambda at: list(pool.map(step, shares, [at] * workers)), reset_all)
    if processes:
        vector = gym.make_vec(env_id, num_envs, vectorization_mode="async")
        rates[f"{num_envs} processes (async)"] = measure(
            lambda at: vector.step(actions[at]), lambda: vector.reset(seed=0)
        )
        vector.close()
    one, _ = next(iter(rates.values()))
    rows = [(name, f"{rate:.0f}", f"{rate / one:.2f}", f"{cpu:.2f}") for name, (rate, cpu) in rates.items()]
    print(markdown_table(["", "steps / s", "ratio", "CPU ms a step, in this process"], rows), end="")


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
