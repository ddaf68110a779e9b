"""What behaviours earn by the staged reward of ArmRetrieve: the script, and four that do not finish.

    python -m scripts.staged_returns

Behaviours go on until the episode ends or its time is up; then each is credited with what its last step earned, for
ever, as a learner credits it that goes on with its estimate there. Undiscounted returns end with the time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, cast

import gymnasium as gym
import numpy as np
import tyro
from numpy.typing import NDArray

import clutter_env
from clutter_env.envs.arm_retrieve import ArmRetrieveEnv
from clutter_env.envs.staged_reward import DISCOUNT
from clutter_env.policies.scripted import arm_retrieve
from clutter_env.reporting.tables import markdown_table
from clutter_env.scene.layout import TABLE_HEIGHT
from clutter_env.seeds import held_out_seeds

DISCOUNTS = (0.90, 0.95, DISCOUNT, 1.0)
ABOVE = 0.05
"""[m] of the TCP above its grasp of the target, while it hovers."""
RAISED = 0.05
"""[m] by which the target is lifted, while it is held low."""

Act = Callable[[ArmRetrieveEnv], NDArray[Any]]


def main(scenes: int = 50) -> None:
    """Play the behaviours and print the table.

    Args:
        scenes: Number of held-out scenes of each environment.
    """
    rows = []
    for count in clutter_env.ARM_RETRIEVE_COUNTS:
        env = gym.make(f"clutter_env/ArmRetrieve-o{count}-v0")
        seeds = held_out_seeds(scenes)
        found = {name: np.array([play(env, act, seed) for seed in seeds]) for name, act in BEHAVIOURS.items()}
        for name, returns in found.items():
            won = [f"{np.count_nonzero(found[FINISHING][:, k] > returns[:, k])}" for k in range(len(DISCOUNTS))]
            means = [f"{value:.2f}" for value in returns.mean(axis=0)]
            rows.append((f"o{count}", name, *means, "–" if name == FINISHING else ", ".join(won)))
        env.close()
    heads = [f"γ = {discount:g}" for discount in DISCOUNTS]
    print(markdown_table(("env", "behaviour", *heads, f"less than finishing, of {scenes}"), rows), end="")


def play(env: gym.Env[Any, Any], act: Act, seed: int) -> list[float]:
    """Returns of an episode for each of `DISCOUNTS`."""
    env.reset(seed=seed)
    inner, rewards, terminated, truncated = cast(ArmRetrieveEnv, env.unwrapped), list[float](), False, False
    while not (terminated or truncated):
        _, reward, terminated, truncated, _ = env.step(act(inner))
        rewards.append(float(reward))
    returns = []
    for discount in DISCOUNTS:
        earned = math.fsum(discount**step * reward for step, reward in enumerate(rewards))
        if discount < 1 and not terminated:
            earned += discount ** len(rewards) * rewards[-1] / (1 - discount)
        returns.append(earned)
    return returns


def finish(env: ArmRetrieveEnv) -> NDArray[Any]:
    """The script's action."""
    return arm_retrieve(env)[1]


def hover(env: ArmRetrieveEnv) -> NDArray[Any]:
    """Hold the open gripper above the target."""
    target = env.measurements.poses[env.target_slot, :3] - env.origin
    return env.arm_action(target + (0, 0, ABOVE + env.world.scene.half_extents[env.target_slot, 2]), 0.1)


def hold_low(env: ArmRetrieveEnv) -> NDArray[Any]:
    """Act as the script, but lift the target by `RAISED` alone."""
    if env.measurements.held != env.target_slot:
        return finish(env)
    raised = env.world.lowest_point(env.measurements, env.target_slot) - TABLE_HEIGHT
    return env.arm_action(env.tcp + (0, 0, RAISED - raised), 0.0)


def idle(env: ArmRetrieveEnv) -> NDArray[Any]:  # noqa: ARG001  one signature for all
    """Stand still, the gripper open."""
    return np.array([0.0, 0.0, 0.0, 1.0])


def act_at_random(env: ArmRetrieveEnv) -> NDArray[Any]:
    """An action drawn uniformly."""
    return env.np_random.uniform(-1, 1, env.action_size)


FINISHING = "finishing (the script)"
BEHAVIOURS: Mapping[str, Act] = MappingProxyType(
    {
        FINISHING: finish,
        "holding the target low": hold_low,
        "hovering over the target": hover,
        "idling": idle,
        "random actions": act_at_random,
    }
)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
