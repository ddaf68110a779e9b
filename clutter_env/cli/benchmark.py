"""How fast the environments are: steps, resets, pictures and memory over the number of objects.

CPU time of one process throughout; random actions, state observations, episodes of 300 steps. Every count is measured
in a process of its own, whose peak memory is reported.
"""

from __future__ import annotations

import json
import multiprocessing
import platform
import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import mujoco
import numpy as np
from tqdm import tqdm

from clutter_env.cli.command import run_command
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.errors import RenderingUnavailable

EPISODE_STEPS = 300
RENDER_FRAMES = 60
RESETS = 100


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    objects: tuple[int, ...] = (1, 5, 10, 15, 20, 25, 30, 40, 50, 60)
    """Numbers of objects to measure."""
    steps: int = 3000
    """Control steps for each number."""
    layout: str = "paper"
    control_mode: str = "joint"
    seed: int = 0
    output: Path = field(default_factory=lambda: Path("outputs/benchmark.png"))
    """Where the plot goes."""
    json: Path | None = None
    """Where machine-readable results go."""


@dataclass(frozen=True)
class Measurement:
    """One row of the table; times are CPU times."""

    objects: int
    steps_per_s: float
    step_over_physics: float
    physics_step_us: float
    reset_median_ms: float
    frames_per_s: float | None
    memory_mb: float


def measure(objects: int, arguments: Arguments) -> Measurement:
    """All figures for one number of objects, in this process."""
    env = RetrieveEnv(num_objects=objects, layout=arguments.layout, control_mode=arguments.control_mode)
    step_time, physics_time = _time_steps(env, arguments.steps, arguments.seed)
    reset_times = [_reset_time(env, seed) for seed in range(RESETS)]
    return Measurement(
        objects=objects,
        steps_per_s=arguments.steps / step_time,
        step_over_physics=step_time / physics_time,
        physics_step_us=physics_time / arguments.steps / 25 * 1e6,
        reset_median_ms=median(reset_times) * 1e3,
        memory_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        frames_per_s=_frames_per_second(objects, arguments),
    )


def _time_steps(env: RetrieveEnv, steps: int, seed: int) -> tuple[float, float]:
    """CPU time [s] of `steps` random steps, without resets, and of the physics steps among it."""
    physics = _Stopwatch(mujoco.mj_step)
    actions = np.random.default_rng(seed).uniform(-1, 1, (steps, env.action_size)).astype(np.float32)
    total = 0.0
    mujoco.mj_step = physics
    try:
        for index, action in enumerate(actions):
            if index % EPISODE_STEPS == 0:
                env.reset(seed=seed + index)
            start = time.process_time()
            env.step(action)
            total += time.process_time() - start
    finally:
        mujoco.mj_step = physics.function
    return total, physics.seconds


class _Stopwatch:
    """A function that adds up the CPU time spent in it."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self.seconds = 0.0

    def __call__(self, *values: Any, **keywords: Any) -> None:
        start = time.process_time()
        self.function(*values, **keywords)
        self.seconds += time.process_time() - start


def _reset_time(env: RetrieveEnv, seed: int) -> float:
    start = time.process_time()
    env.reset(seed=seed)
    return time.process_time() - start


def _frames_per_second(objects: int, arguments: Arguments) -> float | None:
    """Pictures of 480 × 480 per second of wall-clock time, None without OpenGL."""
    env = RetrieveEnv(num_objects=objects, layout=arguments.layout, render_mode="rgb_array")
    env.reset(seed=arguments.seed)
    try:
        env.render()
    except RenderingUnavailable:
        return None
    start = time.perf_counter()
    for _ in range(RENDER_FRAMES):
        env.render()
    rate = RENDER_FRAMES / (time.perf_counter() - start)
    env.close()
    return rate


def table(rows: list[Measurement]) -> str:
    """The results as a Markdown table."""
    lines = [
        "| objects | steps/s | step / physics | µs per physics step | reset, median ms | 480 × 480 frames/s | MB |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        frames = "–" if row.frames_per_s is None else f"{row.frames_per_s:.0f}"
        lines.append(
            f"| {row.objects} | {row.steps_per_s:.0f} | {row.step_over_physics:.2f} | {row.physics_step_us:.1f} "
            f"| {row.reset_median_ms:.2f} | {frames} | {row.memory_mb:.0f} |"
        )
    return "\n".join(lines)


def plot(rows: list[Measurement], file: Path) -> None:
    """Four panels over the number of objects."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    panels = {
        "steps_per_s": "control steps per CPU second",
        "reset_median_ms": "median reset [ms]",
        "frames_per_s": "480 × 480 pictures per second",
        "memory_mb": "peak memory [MB]",
    }
    figure, axes = pyplot.subplots(2, 2, figsize=(9, 6), layout="constrained")
    for axis, (name, title) in zip(axes.ravel(), panels.items(), strict=True):
        values = [getattr(row, name) for row in rows]
        axis.plot([row.objects for row in rows], [np.nan if value is None else value for value in values], "o-")
        axis.set(title=title, xlabel="objects")
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=120)
    pyplot.close(figure)


def run(arguments: Arguments) -> None:
    """Measure, print, plot, save."""
    context = multiprocessing.get_context("spawn")
    rows = []
    for objects in tqdm(arguments.objects, desc="measuring", unit="count"):
        with context.Pool(1) as pool:
            rows.append(pool.apply(measure, (objects, arguments)))
    print(table(rows))
    plot(rows, arguments.output)
    print(f"plot: {arguments.output}")
    if arguments.json is not None:
        about = {"python": platform.python_version(), "mujoco": mujoco.__version__, "machine": platform.machine()}
        content = {"about": about, "layout": arguments.layout, "rows": [asdict(row) for row in rows]}
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(content, indent=1))


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("benchmark", Arguments, run, __doc__, words)
