"""Speed of the Retrieve environment after most objects have toppled.

Every object gets a random velocity, the robot retreats for a second, then the CPU time of random steps is measured.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from statistics import fmean, median

import mujoco
import numpy as np

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.reporting.progress import progress_bar

__all__ = ["ToppledSpeed", "measure_toppled", "topple_objects", "wake"]

TOPPLING_SPEED, TOPPLING_SPIN = 2.0, 16.0
"""[m/s], [rad/s] Bounds of the objects' random velocities at the start; nine of ten objects topple."""
SETTLING_STEPS = 20
"""Control steps in which the robot drives back before the measurement begins."""
MEASURED_STEPS = 300


@dataclass(frozen=True)
class ToppledSpeed:
    """What was measured.

    Attributes:
        steps_per_s: control steps in a second of CPU time, one number for each episode.
        toppled: objects toppled or off the table at the end of an episode, mean.
        awake: objects awake at a control step, mean.
        rows: constraint rows at a control step, mean.
    """

    steps_per_s: tuple[float, ...]
    toppled: float
    awake: float
    rows: float

    def summary(self) -> str:
        """The figures in one line."""
        return (
            f"toppled {self.toppled:.0f}: median {median(self.steps_per_s):.0f} steps/s, "
            f"worst {min(self.steps_per_s):.0f}, {self.awake:.1f} objects awake, {self.rows:.0f} constraint rows"
        )


def measure_toppled(num_objects: int = 40, episodes: int = 20, seed: int = 0) -> ToppledSpeed:
    """Steps per second after toppling, over random episodes of `MEASURED_STEPS` control steps.

    Args:
        num_objects: on the table.
        episodes: how many; each starts from a scene of its own.
        seed: of the first scene; the following numbers are those of the others.

    Raises:
        ValueError: no episodes.
    """
    if episodes < 1:
        raise ValueError(f"episodes={episodes} must be at least 1")
    env = RetrieveEnv(num_objects=num_objects)
    objects, back = env.world.index.object_bodies, np.zeros(env.action_size, np.float32)
    back[0], back[-1] = -1.0, 1.0
    rates, toppled, awake, rows = [], [], [], []
    for episode in progress_bar(range(seed, seed + episodes), desc="toppled", unit="episode"):
        rng = np.random.default_rng(episode)
        env.reset(seed=episode)
        topple_objects(env, rng)
        for _ in range(SETTLING_STEPS):
            env.step(back)
        seconds = 0.0
        for action in rng.uniform(-1, 1, (MEASURED_STEPS, env.action_size)).astype(np.float32):
            start = time.process_time()
            info = env.step(action)[4]
            seconds += time.process_time() - start
            awake.append(int((env.data.body_awake[objects] == int(mujoco.mjtSleepState.mjS_AWAKE)).sum()))
            rows.append(env.data.nefc)
        rates.append(MEASURED_STEPS / seconds)
        toppled.append(info["num_fallen"])
    return ToppledSpeed(tuple(rates), fmean(toppled), fmean(awake), fmean(rows))


def topple_objects(env: RetrieveEnv, rng: np.random.Generator) -> None:
    """Give every object a random velocity in the horizontal plane and a random spin, and wake it."""
    model, data, dof = env.model, env.data, env.world.index.object_dof
    bounds = np.array([TOPPLING_SPEED, TOPPLING_SPEED, 0.0, *[TOPPLING_SPIN] * 3])
    data.qvel[dof] = (rng.uniform(-1, 1, (env.world.index.num_objects, 6)) * bounds).ravel()
    wake(model, data)


def wake(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Wake all bodies, as setting a state does; a sleeping one does not notice that its pose or velocity is written."""
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    mujoco.mj_setState(model, data, state, kind)
