"""Plans for goals in the scenes of Rearrange: how many are found, in how many picks, in which time.

python scripts/goal_benchmark.py --task sort --objects 20 --scenes 50
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import tyro
from tqdm import tqdm

import clutter_env  # noqa: F401  registers the environments
from planners import Scene, Solution, solve, warmup


@dataclass(frozen=True)
class Arguments:
    """What to plan for: `task` of Rearrange with so many `objects`, in so many `scenes` from `seed` on."""

    task: str = "sort"
    objects: int = 20
    scenes: int = 50
    seed: int = 200_000


def main(arguments: Arguments) -> None:
    """Print one row."""
    warmup()
    env = gymnasium.make(f"clutter_env/Rearrange-o{arguments.objects}-v0", task=arguments.task)
    inner: Any = env.unwrapped
    seconds: list[float] = []
    causes: list[str] = []
    picks = bounds = reached = 0
    for seed in tqdm(range(arguments.seed, arguments.seed + arguments.scenes)):
        env.reset(seed=seed)
        scene = Scene.from_mujoco(inner.model, inner.data, inner.robot, regions=inner.regions)
        before = time.process_time()
        found = solve(scene, inner.goal)
        seconds.append(time.process_time() - before)
        if isinstance(found, Solution):
            assert found.end is not None
            assert inner.goal.holds(found.end, scene)
            reached += 1
            picks += found.picks
            bounds += 0 if found.bound is None else found.bound.least
        else:
            causes.append(f"{seed}: {found.cause}")
    median, late = np.quantile(seconds, (0.5, 0.95))
    print(
        f"{arguments.task}, {arguments.objects} objects: {reached} of {arguments.scenes} planned; "
        f"picks / bound {picks} / {bounds}; CPU time {median:.2f} s in the median, 95% {late:.2f} s"
    )
    for cause in causes:
        print(f"  {cause}")


if __name__ == "__main__":
    main(tyro.cli(Arguments))
