"""Policies of training runs by reinforcement or cloning, loaded from the directories of the runs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from clutter_env.policies.cloning import POLICY_FILE, ClonedPolicy
from clutter_env.policies.protocol import Policy
from clutter_env.policies.reinforcement import ScaledActions, load_model, training_env
from clutter_env.policies.runs import CLONERS, GOAL_ALGORITHMS, load_run


def load_trained(directory: Path, env: gym.Env) -> Policy:
    """The policy of a training run, for an environment of the task that it was trained on.

    Raises:
        LearningError: the directory holds no trained policy, a damaged one, or one of version 0.1.
    """
    algorithm = load_run(directory)["algorithm"]
    if algorithm in CLONERS:
        return ClonedPolicy.load(directory / POLICY_FILE)
    return ModelPolicy(algorithm, load_model(algorithm, directory, training_env(algorithm, env)), env)


class ModelPolicy:
    """A Stable-Baselines3 model as a policy in `env`: the most probable action, in the scale of the environment.

    Action masks exclude skills that have just failed, but not skills without a free grasp.

    Args:
        algorithm: that trained the model.
        model: from observations of `training_env` to its actions.
        env: where to act.
    """

    def __init__(self, algorithm: str, model: Any, env: gym.Env) -> None:
        self._model, self._env, self._is_masked = model, env, algorithm == "maskable_ppo"
        self._scaled = ScaledActions(env) if algorithm in GOAL_ALGORITHMS else None

    def reset(self, info: Mapping[str, Any]) -> None:
        """Start an episode; nothing is remembered of the last one."""

    def act(self, observation: Any) -> Any:
        """The most probable action."""
        masks = self._env.get_wrapper_attr("action_masks")(geometric=False) if self._is_masked else None
        options = {} if masks is None else {"action_masks": masks}
        action, _ = self._model.predict(observation, deterministic=True, **options)
        return np.asarray(action) if self._scaled is None else self._scaled.action(action)
