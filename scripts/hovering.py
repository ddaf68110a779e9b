"""What is earned from where a policy of ArmRetrieve comes to stand: by going on, by closing the fingers, by the script.

    python -m scripts.hovering outputs/runs/RUN

The policy acts for some steps of held-out scenes. From the state it is in then each behaviour goes on for 40 steps;
what has not ended by then is credited with its last reward for ever, as a learner credits it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, cast

import gymnasium as gym
import numpy as np
import tyro
from numpy.typing import NDArray

from clutter_env.envs.arm_retrieve import ArmRetrieveEnv
from clutter_env.policies.playing import played
from clutter_env.policies.protocol import AnyPolicy, begin_episode
from clutter_env.policies.registry import load_policy
from clutter_env.policies.scripted import arm_retrieve
from clutter_env.reporting.tables import markdown_table
from clutter_env.seeds import held_out_seeds

GOES_ON = 40
"""[steps] of each behaviour."""

Act = Callable[[ArmRetrieveEnv, AnyPolicy, Any], NDArray[Any]]


def main(
    policy: tyro.conf.Positional[str], objects: int = 1, scenes: int = 20, after: int = 60, discount: float = 0.95
) -> None:
    """Play and print what each behaviour earns and how it ends.

    Args:
        policy: Directory of a training run, or a policy's name.
        objects: In each scene.
        scenes: Number of held-out scenes.
        after: Steps of the policy before.
        discount: Of the returns.
    """
    env = gym.make(f"clutter_env/ArmRetrieve-o{objects}-v0")
    actor = load_policy(policy, 0)
    found: dict[str, list[tuple[float, str]]] = {name: [] for name in BEHAVIOURS}
    for seed in held_out_seeds(scenes):
        state = stand(env, actor, seed, after)
        if state:
            for name, act in BEHAVIOURS.items():
                found[name].append(go_on(env, actor, act, state, discount))
    rows = []
    for name, results in found.items():
        ends = ", ".join(f"{end} {count}" for end, count in Counter(end for _, end in results).most_common())
        returns = [earned for earned, _ in results] or [math.nan]
        rows.append((name, f"{np.mean(returns):.1f}", f"{min(returns):.1f} to {max(returns):.1f}", ends))
    print(markdown_table(("behaviour", f"return, γ = {discount:g}", "range", "ends"), rows), end="")


def stand(env: gym.Env[Any, Any], policy: AnyPolicy, seed: int, steps: int) -> bytes:
    """The state in which the policy is after some steps of a scene; empty if the episode has ended."""
    observation, info = env.reset(seed=seed)
    begin_episode(policy, info, env)
    for _, step in zip(range(steps), played(policy, env.step, observation), strict=False):
        if step.is_over:
            return b""
    return cast(ArmRetrieveEnv, env.unwrapped).save_state()


def go_on(env: gym.Env[Any, Any], policy: AnyPolicy, act: Act, state: bytes, discount: float) -> tuple[float, str]:
    """Return of a behaviour from a state, and how it ends."""
    observation, info = env.reset(options={"state": state})
    inner, earned, reward, terminated, step = cast(ArmRetrieveEnv, env.unwrapped), 0.0, 0.0, False, 0
    while step < GOES_ON and not terminated:
        observation, gained, terminated, _, info = env.step(act(inner, policy, observation))
        reward = float(gained)
        earned += discount**step * reward
        step += 1
    if not terminated:
        earned += discount**step * reward / (1 - discount)
    if info["is_success"]:
        return earned, "success"
    if info["num_disturbed"] or info["num_fallen"]:
        return earned, "disturbed"
    return earned, "pressed" if terminated else "time"


def go_on_as_before(env: ArmRetrieveEnv, policy: AnyPolicy, observation: Any) -> NDArray[Any]:  # noqa: ARG001
    """The policy's own action."""
    return np.asarray(policy.act(observation))


def close_and_lift(env: ArmRetrieveEnv, policy: AnyPolicy, observation: Any) -> NDArray[Any]:  # noqa: ARG001
    """Close the fingers where they are; lift what is held."""
    return np.array([0.0, 0.0, float(env.measurements.held == env.target_slot), -1.0])


def follow_the_script(env: ArmRetrieveEnv, policy: AnyPolicy, observation: Any) -> NDArray[Any]:  # noqa: ARG001
    """The script's action."""
    return arm_retrieve(env)[1]


BEHAVIOURS: Mapping[str, Act] = MappingProxyType(
    {
        "going on": go_on_as_before,
        "closing where it is, then lifting": close_and_lift,
        "the script": follow_the_script,
    }
)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
