"""Trained policies of all algorithms with one interface, loaded from the directories of their training runs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.policies.chosen import put_chosen
from clutter_env.learning.policies.corrections import CorrectedActions, CorrectedAgent
from clutter_env.learning.policies.policy import Policy
from clutter_env.learning.policies.rl import ALGORITHMS, ScaledActions, acting_part, load_model, training_env
from clutter_env.policies.runs import CLONERS, GOAL_ALGORITHMS, load_run

__all__ = ["POLICY_FILE", "Agent", "load_agent", "model_agent"]

Agent = Callable[[Any], Any]
"""From an observation to the action. One that remembers something has a method `reset`, which begins an episode."""
POLICY_FILE = "policy.pt"


def load_agent(directory: Path, env: gym.Env) -> Agent:
    """The policy of a training run, for an environment of the task that it was trained on.

    Of a learner that improves a clone the weights that did best on the validation scenes, else the last ones.

    Raises:
        LearningError: the directory holds no trained policy.
    """
    algorithm = load_run(directory)["algorithm"]
    if algorithm in CLONERS:
        return Policy.load(directory / POLICY_FILE).act
    imitation = Policy.load(directory / POLICY_FILE) if (directory / POLICY_FILE).exists() else None
    model = load_model(algorithm, directory, training_env(algorithm, env, imitation))
    put_chosen(acting_part(model), directory)
    return model_agent(algorithm, model, env, imitation)


def model_agent(algorithm: str, model: Any, env: gym.Env, imitation: Policy | None = None) -> Agent:
    """A Stable-Baselines3 model as a policy in `env`: the most probable action, in the scale of the environment.

    Action masks exclude skills that have just failed, but not skills without a free grasp.

    Args:
        algorithm: that trained the model.
        model: from observations of `training_env` to its actions.
        env: where to act.
        imitation: that the model corrects.
    """
    assert algorithm in ALGORITHMS
    if imitation is not None:
        return _corrected(model, training_env(algorithm, env, imitation), imitation)
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


def _corrected(model: Any, env: gym.Env, imitation: Policy) -> Agent:
    assert isinstance(env, CorrectedActions)
    assert env.imitation is imitation

    def correct(seen: NDArray[np.float32]) -> NDArray[Any]:
        """The most probable correction."""
        return np.asarray(model.predict(seen, deterministic=True)[0])

    return CorrectedAgent(env, correct)
