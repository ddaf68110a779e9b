"""What two threads of MuJoCo's pool would reach with many environments in one process: from CPU times, not wall time.

The physics of recorded episodes is stepped again by `mujoco.batch`, on one and on two threads. Everything else in
`env.step` is Python and stays on one thread. Synchronisation of the threads is left out, so the share of linear scaling
that follows is an upper bound; but other processes on the machine do not distort it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from clutter_env.config import PHYSICS_STEPS
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.experiments.environments.cpu_time import Stopwatch, cpu_time
from clutter_env.simulation.control import SEGMENTS

__all__ = ["BatchScaling", "measure_batch"]

STEPS = 60
"""Control steps of each environment; in so few the robot touches nothing, so that the fingers stay uncoupled."""


@dataclass(frozen=True)
class BatchScaling:
    """CPU times [s] of a control step of one environment among many.

    Attributes:
        step: of `env.step`, the environments in turn.
        physics: of the physics steps in it.
        batch: of the same physics in a batch, on one and on two threads, both threads together.
        is_same: whether the batch ended in the same joint positions, bit for bit.
    """

    step: float
    physics: float
    batch: tuple[float, float]
    is_same: bool

    @property
    def share_of_linear(self) -> float:
        """Speed on two threads over twice the speed on one, at most."""
        return self.step / 2 / (self.step - self.physics + self.batch[1] / 2)

    def summary(self) -> str:
        """The figures in one line."""
        one, two = self.batch
        return (
            f"CPU time of a control step: {self.step * 1e6:.0f} µs, of its physics: {self.physics * 1e6:.0f} µs; "
            f"in a batch: {one * 1e6:.0f} µs on one thread, {two * 1e6:.0f} µs on two; same bits: {self.is_same}; "
            f"two threads reach at most {self.share_of_linear:.2f} of linear"
        )


def measure_batch(num_envs: int, num_objects: int = 20, seed: int = 0) -> BatchScaling:
    """Random steps of `num_envs` environments, and their physics in a batch."""
    envs = [RetrieveEnv(num_objects=num_objects) for _ in range(num_envs)]
    actions = np.random.default_rng(seed).uniform(-1, 1, (STEPS, num_envs, envs[0].action_size))
    step = _step(envs, actions, seed)
    physics = _Recorder(mujoco.mj_step)
    mujoco.mj_step = physics
    try:
        _step(envs, actions, seed)
    finally:
        mujoco.mj_step = physics.function
    commands = np.array(physics.commands).reshape(STEPS, num_envs, SEGMENTS, -1)
    final = np.array([env.data.qpos for env in envs])
    times, ends = zip(*(_run_batch(envs, commands, threads, seed) for threads in (1, 2)), strict=True)
    scale = 1 / (STEPS * num_envs)
    is_same = all(np.array_equal(end, final) for end in ends)
    return BatchScaling(step * scale, physics.seconds * scale, (times[0] * scale, times[1] * scale), is_same)


def _step(envs: list[RetrieveEnv], actions: NDArray[np.float64], seed: int) -> float:
    """CPU time [s] of steps with actions (steps, num_envs, k) from new episodes on, without the resets."""
    _reset(envs, seed)
    return cpu_time(lambda: [env.step(action) for row in actions for env, action in zip(envs, row, strict=True)])


def _reset(envs: list[RetrieveEnv], seed: int) -> None:
    for number, env in enumerate(envs):
        env.reset(seed=seed + number)


class _Recorder(Stopwatch):
    """`mj_step` that adds up its CPU time and keeps the motor commands."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self.commands: list[NDArray[np.float64]] = []

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData, nstep: int) -> None:
        self.commands.append(data.ctrl.copy())
        super().__call__(model, data, nstep=nstep)


def _run_batch(
    envs: list[RetrieveEnv], commands: NDArray[np.float64], threads: int, seed: int
) -> tuple[float, NDArray[np.float64]]:
    """CPU time [s] of all control steps in a batch, and the joint positions (num_envs, nq) in the end.

    Args:
        envs: whose models and first states are taken.
        commands: (steps, num_envs, segments, nu) of the motors.
        threads: of the pool.
        seed: of the first states.
    """
    _reset(envs, seed)
    batch = Batch(envs[0].model, nsim=len(envs), nthread=threads, persistent=True)
    batch.set_models([env.model for env in envs])
    batch.reset(stage=0)
    for name in ("qpos", "qvel", "ctrl", "eq_active"):
        batch.bind(name)[:] = [getattr(env.data, name) for env in envs]
    batch.bind("eq_active")[:] = 0
    every = commands.repeat(PHYSICS_STEPS // SEGMENTS, axis=2)
    seconds = cpu_time(lambda: [batch.rollout(PHYSICS_STEPS, control, record=()) for control in every])
    return seconds, np.array(batch.bind("qpos"))
