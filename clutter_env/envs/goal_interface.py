"""A wrapper that shows the goal environment's `compute_reward`, which Gymnasium's wrappers do not pass on."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
from gymnasium.utils import RecordConstructorArgs

__all__ = ["GoalInterface"]


class GoalInterface(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """The outermost wrapper of `Reach` and `Pick`; put it around wrappers of your own too.

    Stable-Baselines3's `check_env` calls `env.compute_reward(...)`, and since Gymnasium 1.0 a wrapper has only the
    attributes of its own class.

    Example:
        env = GoalInterface(gym.wrappers.TimeLimit(env, max_episode_steps=50))
    """

    def __init__(self, env: gym.Env) -> None:
        RecordConstructorArgs.__init__(self)
        super().__init__(env)

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Rewards (...,) of achieved and desired goals (..., 3); see `GoalEnv.compute_reward`."""
        return self.env.get_wrapper_attr("compute_reward")(achieved_goal, desired_goal, info)
