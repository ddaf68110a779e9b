"""Speed, memory and rendering of the environments over the number of objects, with random actions.

    clutter-env benchmark --objects 1 15 40 --steps 2000

CPU times of one process. Every number of objects is measured in a process of its own, whose peak memory is reported.
Each takes about ten seconds.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clutter_env.envs.retrieve import RetrieveEnv

EPISODE_STEPS = 300
RENDERED_FRAMES = 60
RESETS = 100


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    objects: tuple[int, ...] = (1, 5, 10, 15, 20, 25, 30, 40, 50, 60)
    """Numbers of objects to measure."""
    steps: int = 3000
    """Control steps for each number of objects."""
    layout: str = "paper"
    """Table and surroundings."""
    control_mode: str = "joint"
    """Meaning of the actions: "joint" or "ee"."""
    object_set: str = "standard"
    """Sizes, masses and shapes of the objects."""
    reality: float = 0.0
    """Value of the reality dial."""
    seed: int = 0
    """Random seed of scenes and actions."""
    json: Path | None = None
    """File of machine-readable results."""

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError(f"steps={self.steps} must be at least 1")
        if not self.objects:
            raise ValueError("--objects needs at least one value")


_ENVIRONMENT = ("layout", "control_mode", "object_set", "reality")
"""The arguments that the environment has too."""

Measurement = dict[str, float | None]
"""One row of the table. Times are CPU times. Only `frames_per_s` is in wall-clock time, and needs OpenGL: otherwise it
is None.
`step_over_physics`: CPU time of `env.step` over that of its physics steps. `memory_mb`: peak of the process [MB]."""


def run(arguments: Arguments) -> None:
    """Measure, print, save."""
    import multiprocessing
    import platform

    import mujoco

    from clutter_env.reporting.files import write_json
    from clutter_env.reporting.progress import progress_bar

    rows = []
    context = multiprocessing.get_context("spawn")
    for count in progress_bar(arguments.objects, desc="measuring", unit="count"):
        with context.Pool(1) as pool:
            rows.append(pool.apply(measure, (count, arguments)))
    print(speed_table(rows), end="")
    if arguments.json is not None:
        about = {"python": platform.python_version(), "mujoco": mujoco.__version__, "machine": platform.machine()}
        settings = {name: getattr(arguments, name) for name in (*_ENVIRONMENT, "steps", "seed")}
        write_json(arguments.json, {"about": about, "settings": settings, "rows": rows})


def measure(objects: int, arguments: Arguments) -> Measurement:
    """Measure all figures for one number of objects, in this process. Nothing is imported that would add to its
    memory."""
    import resource
    from statistics import median

    from clutter_env.config import PHYSICS_STEPS

    env = _environment(objects, arguments)
    step_s, physics_s = time_steps(env, arguments.steps, arguments.seed)
    resets_s = []
    for seed in range(RESETS):
        start = time.process_time()
        env.reset(seed=seed)
        resets_s.append(time.process_time() - start)
    return {
        "objects": objects,
        "steps_per_s": arguments.steps / step_s,  # control steps, without resets
        "step_over_physics": step_s / physics_s,
        "physics_step_us": physics_s / arguments.steps / PHYSICS_STEPS * 1e6,
        "reset_median_ms": median(resets_s) * 1e3,
        # Taken before anything is rendered, which needs memory of its own.
        "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "frames_per_s": frames_per_second(objects, arguments),
    }


def _environment(objects: int, arguments: Arguments, render_mode: str | None = None) -> RetrieveEnv:
    from clutter_env.envs.retrieve import RetrieveEnv

    keywords = {name: getattr(arguments, name) for name in _ENVIRONMENT}
    return RetrieveEnv(num_objects=objects, render_mode=render_mode, **keywords)


def time_steps(env: RetrieveEnv, steps: int, seed: int) -> tuple[float, float]:
    """CPU time [s] of `steps` random steps, without resets, and of the physics steps among it."""
    import numpy as np

    actions = np.random.default_rng(seed).uniform(-1, 1, (steps, env.action_size)).astype(np.float32)
    total_s = physics_s = 0.0
    with timed_physics(time.process_time) as physics:
        for index, action in enumerate(actions):
            if index % EPISODE_STEPS == 0:
                env.reset(seed=seed + index)
            start, before = time.process_time(), physics.spent_s
            env.step(action)
            total_s += time.process_time() - start
            physics_s += physics.spent_s - before
    return total_s, physics_s


@contextmanager
def timed_physics(clock: Callable[[], float]) -> Iterator[SimpleNamespace]:
    """Time MuJoCo's steps with a clock, in this process, until the block ends. `spent_s` [s] is the time that they
    took."""
    import mujoco

    physics, mj_step = SimpleNamespace(spent_s=0.0), mujoco.mj_step

    def timed_mj_step(*values: Any, **keywords: Any) -> None:
        start = clock()
        mj_step(*values, **keywords)
        physics.spent_s += clock() - start

    mujoco.mj_step = timed_mj_step
    try:
        yield physics
    finally:
        mujoco.mj_step = mj_step


def frames_per_second(objects: int, arguments: Arguments) -> float | None:
    """Images of 480 × 480 per second of wall-clock time, None without OpenGL."""
    from clutter_env.errors import RenderingUnavailable

    env = _environment(objects, arguments, "rgb_array")
    env.reset(seed=arguments.seed)
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


def speed_table(rows: Sequence[Measurement]) -> str:
    """The measurements as a Markdown table."""
    from clutter_env.reporting.tables import markdown_table, number_text

    columns = {
        "objects": ("objects", "{:.0f}"),
        "steps/s": ("steps_per_s", "{:.0f}"),
        "step / physics": ("step_over_physics", "{:.2f}"),
        "µs per physics step": ("physics_step_us", "{:.1f}"),
        "reset, median ms": ("reset_median_ms", "{:.2f}"),
        "480 × 480 frames/s": ("frames_per_s", "{:.0f}"),
        "MB": ("memory_mb", "{:.0f}"),
    }
    cells = [[number_text(row[name], pattern) for name, pattern in columns.values()] for row in rows]
    return markdown_table(list(columns), cells)
