"""Speed, memory and rendering of the environments over the number of objects, with random actions.

    clutter-env benchmark --objects 1 15 40 --steps 2000

CPU times of one process. Every number of objects is measured in a process of its own, whose peak memory is reported.
"""

from __future__ import annotations

import platform
from dataclasses import dataclass
from pathlib import Path

import mujoco

from clutter_env.experiments.environments.batch_scaling import measure_batch
from clutter_env.experiments.environments.resets import compare_resets
from clutter_env.experiments.environments.speed import SpeedSettings, measure_speed, speed_table
from clutter_env.experiments.environments.toppled import measure_toppled
from clutter_env.reporting.files import write_json
from clutter_env.reporting.progress import progress_bar


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    objects: tuple[int, ...] = (1, 5, 10, 15, 20, 25, 30, 40, 50, 60)
    """Numbers of objects to measure."""
    steps: int = SpeedSettings.steps
    """Control steps for each number of objects."""
    layout: str = SpeedSettings.layout
    """Table and surroundings."""
    control_mode: str = SpeedSettings.control_mode
    """Meaning of the actions: "joint" or "ee"."""
    seed: int = SpeedSettings.seed
    """Random seed of scenes and actions."""
    toppled: int = 0
    """Measure only this: steps per second with 40 objects toppled, over so many episodes."""
    resets: int = 0
    """Measure only this: a reset with 20 objects beside one of FetchPickAndPlace, in so many rounds of 100."""
    batch: int = 0
    """Measure only this: so many environments of 20 objects, their physics on one and on two threads of a pool."""
    out: Path = Path("outputs/benchmark.png")
    """File of the plot."""
    json: Path | None = None
    """File of machine-readable results."""


def run(arguments: Arguments) -> None:
    """Measure, print, plot, save."""
    if arguments.toppled:
        print(measure_toppled(episodes=arguments.toppled, seed=arguments.seed).summary())
        return
    if arguments.resets:
        print(compare_resets(rounds=arguments.resets, seed=arguments.seed).summary())
        return
    if arguments.batch:
        print(measure_batch(num_envs=arguments.batch, seed=arguments.seed).summary())
        return
    # The measuring processes import this module: matplotlib, imported above, would count as their memory.
    from clutter_env.experiments.environments.speed_plot import plot_speed

    settings = SpeedSettings(arguments.steps, arguments.layout, arguments.control_mode, arguments.seed)
    measurements = measure_speed(arguments.objects, settings)
    rows = list(progress_bar(measurements, desc="measuring", unit="count", total=len(arguments.objects)))
    print(speed_table(rows), end="")
    plot_speed(rows, arguments.out)
    print(f"plot: {arguments.out}")
    if arguments.json is not None:
        about = {"python": platform.python_version(), "mujoco": mujoco.__version__, "machine": platform.machine()}
        write_json(arguments.json, {"about": about, "settings": settings, "rows": rows})
