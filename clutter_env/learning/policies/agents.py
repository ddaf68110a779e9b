"""Anything that acts, behind one interface, whatever trained it: loaded from the directory of its training run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from clutter_env.learning.policies.policy import Policy
from clutter_env.learning.policies.rl import ALGORITHMS, ScaledActions, load_model, training_env
from clutter_env.learning.policies.runs import CLONERS, GOAL_ALGORITHMS, load_run

__all__ = ["POLICY_FILE", "Agent", "load_agent", "model_agent"]

Agent = Callable[[Any], Any]
"""From an observation to an action."""
POLICY_FILE = "policy.pt"


def load_agent(directory: Path, env: gym.Env) -> Agent:
    """The trained policy, to act in an environment of the task it was trained for.

    Raises:
        LearningError: the directory holds no trained policy.
    """
    algorithm = load_run(directory)["algorithm"]
    if algorithm in CLONERS:
        return Policy.load(directory / POLICY_FILE).act
    return model_agent(algorithm, load_model(algorithm, directory, training_env(algorithm, env)), env)


def model_agent(algorithm: str, model: Any, env: gym.Env) -> Agent:
    """A Stable-Baselines3 model as an agent in `env`: the most probable action, in the environment's own scale.

    Masks leave out attempts that have just failed, never what geometry forbids.
    """
    assert algorithm in ALGORITHMS
    scaled = ScaledActions(env) if algorithm in GOAL_ALGORITHMS else None

    def act(observation: Any) -> Any:
        if algorithm == "maskable_ppo":
            masks = env.get_wrapper_attr("action_masks")(geometric=False)
            action, _ = model.predict(observation, deterministic=True, action_masks=masks)
        else:
            action, _ = model.predict(observation, deterministic=True)
        return np.asarray(action) if scaled is None else scaled.action(action)

    return act
