"""Speed of the Retrieve environment over the number of objects: steps, resets, images, memory.

CPU time of one process; random actions, state observations, episodes of `EPISODE_STEPS` steps. Every number of objects
is measured in a process of its own, because the peak memory is that of a process.
"""

from __future__ import annotations

import multiprocessing
import resource
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from statistics import median

import mujoco
import numpy as np

from clutter_env.config import PHYSICS_STEPS
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.errors import RenderingUnavailable
from clutter_env.experiments.environments.cpu_time import Stopwatch, cpu_time
from clutter_env.reporting.tables import markdown_table, number_text

__all__ = ["SpeedMeasurement", "SpeedSettings", "measure_speed", "speed_table"]

EPISODE_STEPS = 300
RENDERED_FRAMES = 60
RESETS = 100


@dataclass(frozen=True)
class SpeedSettings:
    """What is measured.

    Attributes:
        steps: control steps for each number of objects.
        layout: name of the layout.
        control_mode: "joint" or "ee".
        seed: of scenes and actions.
    """

    steps: int = 3000
    layout: str = "paper"
    control_mode: str = "joint"
    seed: int = 0


@dataclass(frozen=True)
class SpeedMeasurement:
    """One row of the table.

    Attributes:
        objects: on the table.
        steps_per_s: control steps in a second of CPU time, without resets.
        step_over_physics: CPU time of `env.step` over that of the physics steps in it.
        physics_step_us: CPU time of one physics step [µs].
        reset_median_ms: CPU time of a reset [ms].
        frames_per_s: images of 480 × 480 in a second of wall-clock time, None without OpenGL.
        memory_mb: peak memory of the process [MB].
    """

    objects: int
    steps_per_s: float
    step_over_physics: float
    physics_step_us: float
    reset_median_ms: float
    frames_per_s: float | None
    memory_mb: float


def measure_speed(objects: tuple[int, ...], settings: SpeedSettings) -> Iterator[SpeedMeasurement]:
    """One measurement for each number of objects, each in a new process.

    Raises:
        ConfigError: no such layout or control mode, or a number of objects that does not fit.
        ValueError: no steps.
    """
    if settings.steps < 1:
        raise ValueError(f"steps={settings.steps} must be at least 1")
    context = multiprocessing.get_context("spawn")
    for count in objects:
        with context.Pool(1) as pool:
            yield pool.apply(_measure, (count, settings))


def _measure(objects: int, settings: SpeedSettings) -> SpeedMeasurement:
    """All figures for one number of objects, in this process."""
    env = RetrieveEnv(num_objects=objects, layout=settings.layout, control_mode=settings.control_mode)
    step_s, physics_s = _time_steps(env, settings.steps, settings.seed)
    resets_s = [cpu_time(partial(env.reset, seed=seed)) for seed in range(RESETS)]
    return SpeedMeasurement(
        objects=objects,
        steps_per_s=settings.steps / step_s,
        step_over_physics=step_s / physics_s,
        physics_step_us=physics_s / settings.steps / PHYSICS_STEPS * 1e6,
        reset_median_ms=median(resets_s) * 1e3,
        memory_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        frames_per_s=_frames_per_second(objects, settings),
    )


def _time_steps(env: RetrieveEnv, steps: int, seed: int) -> tuple[float, float]:
    """CPU time [s] of `steps` random steps, without resets, and of the physics steps among it."""
    physics = Stopwatch(mujoco.mj_step)
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


def _frames_per_second(objects: int, settings: SpeedSettings) -> float | None:
    """Images of 480 × 480 per second of wall-clock time, None without OpenGL."""
    env = RetrieveEnv(num_objects=objects, layout=settings.layout, render_mode="rgb_array")
    env.reset(seed=settings.seed)
    try:
        env.render()
    except RenderingUnavailable:
        return None
    start = time.perf_counter()
    for _ in range(RENDERED_FRAMES):
        env.render()
    rate = RENDERED_FRAMES / (time.perf_counter() - start)
    env.close()
    return rate


def speed_table(rows: list[SpeedMeasurement]) -> str:
    """The measurements as a Markdown table."""
    head = (
        "objects",
        "steps/s",
        "step / physics",
        "µs per physics step",
        "reset, median ms",
        "480 × 480 frames/s",
        "MB",
    )
    cells = [
        (
            str(row.objects),
            f"{row.steps_per_s:.0f}",
            f"{row.step_over_physics:.2f}",
            f"{row.physics_step_us:.1f}",
            f"{row.reset_median_ms:.2f}",
            number_text(row.frames_per_s, "{:.0f}"),
            f"{row.memory_mb:.0f}",
        )
        for row in rows
    ]
    return markdown_table(head, cells)
