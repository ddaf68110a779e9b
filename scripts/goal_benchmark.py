"""Plans for goals in the scenes of Rearrange: how many are found, in how many picks, in which time; or done in physics.

    python scripts/goal_benchmark.py --task sort --objects 20 --scenes 50
    python scripts/goal_benchmark.py --task stack --objects 8 --scenes 40 --physics --out stack.jsonl

With --physics the expert carries its plan out, and the environment judges: clean success, by the rule of the suites.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import tyro

import clutter_env  # noqa: F401  registers the environments
from clutter_env.reporting.files import JsonLines
from clutter_env.reporting.progress import progress_bar
from planners import Scene, Solution, TampExpert, solve, warmup


@dataclass(frozen=True)
class Arguments:
    """What to plan for: `task` of Rearrange with so many `objects`, in so many `scenes` from `seed` on."""

    task: str = "sort"
    objects: int = 20
    scenes: int = 50
    seed: int = 200_000
    layout: str = ""
    """That of the task if not given."""
    robot: str = "fetch"
    physics: bool = False
    """Let the expert carry the plans out."""
    time_limit: float = 60.0
    """[s] of wall time for one solve; without physics."""
    out: Path | None = None
    """File of JSON lines, one for each scene; scenes that it has are not tried again."""
    minutes: float = math.inf
    """No scene is begun after so much wall time; run the same command again to go on."""


def main(arguments: Arguments) -> None:
    """Try the scenes that are left, and print one row."""
    warmup(arguments.robot)
    keywords: dict[str, Any] = {"layout": arguments.layout} if arguments.layout else {}
    env = gymnasium.make(
        f"clutter_env/Rearrange-o{arguments.objects}-v0", task=arguments.task, robot=arguments.robot, **keywords
    )
    file = JsonLines(arguments.out) if arguments.out else None
    rows = {row["seed"]: row for row in (file.values if file else [])}
    try_scene = carried_out if arguments.physics else partial(planned, time_limit=arguments.time_limit)
    seeds, started = range(arguments.seed, arguments.seed + arguments.scenes), time.monotonic()
    for seed in progress_bar([seed for seed in seeds if seed not in rows]):
        if time.monotonic() - started > 60 * arguments.minutes:
            break
        env.reset(seed=seed)
        rows[seed] = {"seed": seed, **try_scene(env)}
        if file:
            file.append(rows[seed])
    report(arguments, [rows[seed] for seed in seeds if seed in rows])


def report(arguments: Arguments, rows: list[dict[str, Any]]) -> None:
    """Print the summary, and a line for each scene without success."""
    done = [row for row in rows if row["success"]]
    median, late = np.quantile([row["cpu_s"] for row in rows], (0.5, 0.95))
    bounds = [row for row in done if row["bound"] is not None]
    picks, least = sum(row["picks"] for row in bounds), sum(row["bound"] for row in bounds)
    print(
        f"{arguments.task}, {arguments.objects} objects, {arguments.robot}: {len(done)} of {len(rows)} "
        f"{'clean' if 'sim_s' in rows[0] else 'planned'}; picks / bound {picks} / {least}; CPU time of planning "
        f"{median:.2f} s in the median, 95% {late:.2f} s"
    )
    if "sim_s" in rows[0]:
        again = Counter(row["replans"] for row in done)
        print(
            f"  simulated time {np.median([row['sim_s'] for row in done]):.0f} s in the median; "
            f"plans made anew: {', '.join(f'{times} × {count}' for count, times in sorted(again.items()))}"
        )
    for row in rows:
        if not row["success"]:
            print(f"  {row['seed']}: {row['cause']}")


def planned(env: Any, time_limit: float) -> dict[str, Any]:
    """Plan for the goal of a reset environment."""
    inner = env.unwrapped
    scene = Scene.from_mujoco(inner.model, inner.data, inner.robot, regions=inner.regions)
    before = time.process_time()
    found = solve(scene, inner.goal, time_limit=time_limit)
    row = {"success": isinstance(found, Solution), "cpu_s": time.process_time() - before}
    if not isinstance(found, Solution):
        return {**row, "cause": f"{found.cause}: {found.detail}"}
    assert found.end is not None
    assert inner.goal.holds(found.end, scene)
    return {**row, "picks": found.picks, "bound": None if found.bound is None else found.bound.least}


def carried_out(env: Any) -> dict[str, Any]:
    """Let the expert bring the goal about in physics."""
    expert = TampExpert(env)
    expert.reset()
    plan, info, is_over = expert.solution, env.unwrapped.info, expert.done
    while not is_over:
        *_, terminated, truncated, info = env.step(expert.act())
        is_over = terminated or truncated or expert.done
    found, done = expert.report, bool(info["is_success"])
    counts = {name: info[name] for name in ("lifted", "unmet", "num_fallen", "num_disturbed", "num_cleared")}
    force = env.unwrapped.world.furniture_force
    return {
        "success": done,
        "cause": "" if done else f"{found.result}; {counts}, {force:.0f} N; {'; '.join(found.deviations)}",
        "lifted": bool(info["lifted"]),
        "cpu_s": found.planning_s,
        "sim_s": found.sim_s,
        "replans": found.replans,
        "picks": plan.picks if isinstance(plan, Solution) else 0,
        "bound": plan.bound.least if isinstance(plan, Solution) and plan.bound else None,
    }


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
