"""Models of Stable-Baselines3: the environment and the features as they see them, and their files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from sb3_contrib import TQC, MaskablePPO
from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from clutter_env.envs.skill import observed_masks
from clutter_env.errors import LearningError
from clutter_env.policies.cloning import feature_vector
from clutter_env.policies.protocol import PublicInfo
from clutter_env.policies.runs import GOAL_ALGORITHMS
from clutter_env.policies.skill_network import SkillNetwork
from planners import DIRECTIONS

ALGORITHMS: Mapping[str, type[BaseAlgorithm]] = MappingProxyType(
    {"sac": SAC, "tqc": TQC, "ppo": PPO, "maskable_ppo": MaskablePPO}
)
MODEL_FILE, BUFFER_FILE = "model.zip", "replay_buffer.pkl"

BASE_SCALE, TURN_SCALE = 0.1, 0.2
"""Shares of the greatest velocity of the base, and of the greatest turning rate of the gripper, that a full action of a
learner commands. Goals are within the arm's reach; at full speed the noise of exploration drives the base away."""
GRIPPER_SCALE = 0.5
"""Share of the greatest velocity of the gripper that a full action commands. At full speed the commanded pose, which is
not observed, leads the arm by up to 5 cm, and the arm swings where it is folded."""


class ScaledActions(gym.ActionWrapper[Any, Any, Any]):
    """Scales the actions of a learner, so that base and gripper turn and move more slowly."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        self.scale = action_scale(env.action_space, env.get_wrapper_attr("control_mode"))

    def action(self, action: Any) -> Any:
        """The environment's action for an action of the learner."""
        return action * self.scale


def action_scale(space: gym.Space[Any], control_mode: str) -> NDArray[np.float32]:
    """Shares (n,) of the environment's actions that full actions of a learner command."""
    scale = np.ones(space.shape or (), np.float32)
    scale[:3] = BASE_SCALE
    if control_mode == "ee":
        scale[3:6], scale[6:9] = GRIPPER_SCALE, TURN_SCALE
    return scale


def training_env(name: str, env: gym.Env) -> gym.Env:
    """The environment as a learner sees it: with the action scale of its algorithm."""
    return ScaledActions(env) if name in GOAL_ALGORITHMS else env


class GoalFeatures(BaseFeaturesExtractor):
    """`feature_vector` of goal observations, for batches on torch; it has no parameters."""

    def __init__(self, space: gym.spaces.Dict) -> None:
        super().__init__(space, len(feature_vector({name: np.zeros(part.shape or ()) for name, part in space.items()})))

    def forward(self, observation: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Features (k, f) of observations with entries (k, n)."""
        return torch.from_numpy(feature_vector({name: part.numpy() for name, part in observation.items()}))


class _SkillPolicyMixin:
    """Replaces the separate networks of Stable-Baselines3 by `SkillNetwork`, whose logits are those of the policy."""

    action_space: Any
    optimizer_class: Any
    optimizer_kwargs: Any
    parameters: Any

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = SkillNetwork((int(self.action_space.n) - 1) // DIRECTIONS)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)  # type: ignore[misc]  # a mixin: the class beside it has _build
        self.action_net = nn.Identity()
        self.mlp_extractor.initialise_heads()
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)


class SkillPolicy(_SkillPolicyMixin, ActorCriticPolicy):
    """The policy of PPO on Skill."""


class MaskableSkillPolicy(_SkillPolicyMixin, MaskableActorCriticPolicy):
    """The policy of MaskablePPO on Skill."""


def load_model(name: str, directory: Path, env: gym.Env | None = None, with_buffer: bool = False) -> BaseAlgorithm:
    """The model in the directory of a run; with an environment and its replay buffer it is ready to go on learning.

    Raises:
        LearningError: there is none, it is damaged, or it needs code that this version no longer has.
    """
    path = directory / MODEL_FILE
    if not path.exists():
        raise LearningError(f"there is no model in {directory}")
    try:
        model = ALGORITHMS[name].load(path, env=env, device="cpu")
        if with_buffer and isinstance(model, OffPolicyAlgorithm):
            model.load_replay_buffer(directory / BUFFER_FILE, truncate_last_traj=True)
    except Exception as problem:  # pickle, zip and torch raise many kinds for a damaged file or for missing classes
        raise LearningError(
            f"{path} is damaged, or another version of this package wrote it; train again ({problem})"
        ) from problem
    return model


class ModelPolicy:
    """A Stable-Baselines3 model as a policy: the most probable action, in the scale of the environment.

    Action masks exclude skills that have just failed, but not skills without a free grasp.

    Args:
        algorithm: that trained the model.
        model: from observations of `training_env` to its actions.
    """

    def __init__(self, algorithm: str, model: Any) -> None:
        self._model, self._is_masked = model, algorithm == "maskable_ppo"
        self._is_scaled = algorithm in GOAL_ALGORITHMS
        self._scale: NDArray[Any] = np.ones(())

    def check(self, public: PublicInfo) -> None:
        """Note the scale of the actions."""
        if self._is_scaled:
            self._scale = action_scale(public.action_space, public.control_mode)

    def reset(self, info: Mapping[str, Any]) -> None:
        """Start an episode; nothing is remembered of the last one."""

    def act(self, observation: Any) -> Any:
        """The most probable action."""
        options = {"action_masks": observed_masks(observation)} if self._is_masked else {}
        action, _ = self._model.predict(observation, deterministic=True, **options)
        return np.asarray(action) * self._scale if self._is_scaled else np.asarray(action)
