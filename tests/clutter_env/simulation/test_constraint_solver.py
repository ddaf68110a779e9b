"""Contact forces: the solver finds them in every physics step, also where the robot wedges objects in."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from clutter_env.simulation import control
from scripts.soak import ACTION_STEPS, FORWARD_RANGE

CROWDED: dict[str, Any] = {"layout": "dense", "shapes": "mixed"}
FASTEST_SPIN = 100.0
"""[rad/s] Faster than anything that the robot turns; where the solver failed, objects had 300 to 3,900."""


@pytest.mark.parametrize(
    ("keywords", "seed", "steps"),
    [
        (CROWDED | {"num_objects": 8}, 191, 16),
        (CROWDED | {"num_objects": 15}, 19, 21),
        (CROWDED | {"num_objects": 40, "object_set": "heavy"}, 94, 21),
    ],
)
def test_the_solver_ends_before_its_limit_of_iterations(
    keywords: dict[str, Any], seed: int, steps: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    step, iterations = mujoco.mj_step, []

    def count_iterations(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        step(model, data)
        iterations.append(int(data.solver_niter.max()))

    monkeypatch.setattr(control.mujoco, "mj_step", count_iterations)
    env = gym.make("clutter_env/Retrieve-o15-v0", **keywords).unwrapped
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    fastest = 0.0
    for number in range(steps):
        if number % ACTION_STEPS == 0:
            action = rng.uniform(-1, 1, env.action_size)
            action[0] = rng.uniform(*FORWARD_RANGE)
        env.step(action)
        fastest = max(fastest, float(np.abs(env.data.qvel).max()))
    assert max(iterations) < env.model.opt.iterations
    assert fastest < FASTEST_SPIN
