"""Trained policies of all algorithms with one interface, loaded from the directories of their training runs."""

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
"""From an observation to the action."""
POLICY_FILE = "policy.pt"


def load_agent(directory: Path, env: gym.Env) -> Agent:
    """The policy of a training run, for an environment of the task that it was trained on.

    Raises:
        LearningError: the directory holds no trained policy.
    """
    algorithm = load_run(directory)["algorithm"]
    if algorithm in CLONERS:
        return Policy.load(directory / POLICY_FILE).act
    return model_agent(algorithm, load_model(algorithm, directory, training_env(algorithm, env)), env)


def model_agent(algorithm: str, model: Any, env: gym.Env) -> Agent:
    """A Stable-Baselines3 model as a policy in `env`: the most probable action, in the scale of the environment.

    Action masks exclude skills that have just failed, but not skills without a free grasp.
    """
    assert algorithm in ALGORITHMS
    scaled = ScaledActions(env) if algorithm in GOAL_ALGORITHMS else None

    def act(observation: Any) -> Any:
        """The most probable action."""
        if algorithm == "maskable_ppo":
            masks = env.get_wrapper_attr("action_masks")(geometric=False)
            action, _ = model.predict(observation, deterministic=True, action_masks=masks)
        else:
            action, _ = model.predict(observation, deterministic=True)
        return np.asarray(action) if scaled is None else scaled.action(action)

    return act
