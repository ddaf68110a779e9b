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
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from clutter_env.envs.skill import observed_masks
from clutter_env.policies.cloning import feature_vector
from clutter_env.policies.protocol import PolicyError, PublicInfo
from clutter_env.policies.runs import GOAL_ALGORITHMS
from clutter_env.policies.skill_network import SkillNetwork
from clutter_env.policies.weights import damage_refused, read_arrays, tensors
from planners import DIRECTIONS

ALGORITHMS: Mapping[str, type[BaseAlgorithm]] = MappingProxyType(
    {"sac": SAC, "tqc": TQC, "ppo": PPO, "maskable_ppo": MaskablePPO}
)
FOREIGN_ALGORITHMS: Mapping[str, type[BaseAlgorithm]] = MappingProxyType(
    {**ALGORITHMS, "a2c": A2C, "ddpg": DDPG, "dqn": DQN, "td3": TD3}
)
"""Those whose files, made elsewhere, can be loaded as policies."""
MODEL_FILE = "model.npz"
"""Parameters, state of the optimisers and counters of a model, in the directory of a run."""

BASE_SCALE, TURN_SCALE = 0.1, 0.2
"""Shares of the greatest velocity of the base, and of the greatest turning rate of the gripper, that a full action of a
learner commands. Goals are within the arm's reach; at full speed the noise of exploration drives the base away."""
GRIPPER_SCALE = 0.5
"""Share of the greatest velocity of the gripper that a full action commands. At full speed the commanded pose, which is
not observed, leads the arm by up to 5 cm, and the arm swings where it is folded."""


_EE_ACTIONS = 10
"""Numbers in an action of "ee" control: base, twist of the gripper, fingers."""


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


_GOAL_NETWORK: Mapping[str, Any] = MappingProxyType({"net_arch": [128, 128], "features_extractor_class": GoalFeatures})
NETWORKS: Mapping[str, tuple[type[BasePolicy], Mapping[str, Any]]] = MappingProxyType(
    {
        "sac": (SAC.policy_aliases["MultiInputPolicy"], _GOAL_NETWORK),
        "tqc": (TQC.policy_aliases["MultiInputPolicy"], _GOAL_NETWORK),
        "ppo": (SkillPolicy, {}),
        "maskable_ppo": (MaskableSkillPolicy, {}),
    }
)
"""The networks of an algorithm (actor and critics) and their keyword arguments."""


def load_network(algorithm: str, directory: Path) -> BasePolicy:
    """The networks of a training run, made anew, with the parameters in its directory.

    Raises:
        PolicyError: there is no model, it is damaged, or another version wrote it.
    """
    path = directory / MODEL_FILE
    arrays, about = read_arrays(path)
    with damage_refused(path):
        kind, options = NETWORKS[algorithm]
        spaces = (_space(about[name]) for name in ("observation", "action"))
        network = kind(*spaces, lambda _: 0.0, **options)
        network.load_state_dict(tensors(arrays, "policy/"))
    return network


def space_shape(space: gym.Space[Any]) -> Any:
    """Number of choices, shape, or shapes by name, as JSON values."""
    if isinstance(space, gym.spaces.Dict):
        return {name: space_shape(part) for name, part in space.items()}
    return int(space.n) if isinstance(space, gym.spaces.Discrete) else list(space.shape or ())


def _space(shape: Any) -> gym.Space[Any]:
    if isinstance(shape, Mapping):
        return gym.spaces.Dict({name: _space(part) for name, part in shape.items()})
    return gym.spaces.Discrete(shape) if isinstance(shape, int) else gym.spaces.Box(-1, 1, tuple(shape))


class ModelPolicy:
    """A Stable-Baselines3 model as a policy: the most probable action, in the scale of the environment.

    Action masks exclude skills that have just failed, but not skills without a free grasp.

    Args:
        algorithm: that trained the model.
        model: from observations of `training_env` to its actions; or its networks.
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


class ZipPolicy(ModelPolicy):
    """The policy in a file that Stable-Baselines3 saved; its actions are those of the environment.

    Loading the file executes code that is in it.

    Args:
        algorithm: that trained it, one of `FOREIGN_ALGORITHMS`.
        path: of the file.

    Attributes:
        acts_by_skills: whether it has learned on Skill, whose actions are numbers.
        grasps: those of the skills are level ones.
        env_keywords: the control mode, from the size of the actions.
        place: the file.

    Raises:
        PolicyError: no such algorithm or file, or one that cannot be loaded.
    """

    def __init__(self, algorithm: str, path: Path) -> None:
        if algorithm not in FOREIGN_ALGORITHMS:
            known = ", ".join(FOREIGN_ALGORITHMS)
            raise PolicyError(f"{algorithm!r} is no algorithm; name a file ALGORITHM:{path}, with one of {known}")
        if not path.is_file():
            raise PolicyError(f"there is no file {path}")
        try:
            model = FOREIGN_ALGORITHMS[algorithm].load(path, device="cpu")
        except Exception as problem:  # whatever the code in the file raises
            raise PolicyError(f"{path} cannot be loaded as a model of {algorithm}: {problem!r}") from problem
        super().__init__(algorithm, model)
        self._is_scaled, self._spaces = False, (model.observation_space, model.action_space)
        self.place = str(path)
        self.acts_by_skills = isinstance(model.action_space, gym.spaces.Discrete)
        self.grasps = "side" if self.acts_by_skills else "all"
        mode = "ee" if space_shape(model.action_space) == [_EE_ACTIONS] else "joint"
        self.env_keywords = {} if self.acts_by_skills else {"control_mode": mode}

    def check(self, public: PublicInfo) -> None:
        """Refuse an environment with other observations or actions (`PolicyError`)."""
        own, there = (
            " and ".join(str(space_shape(space)) for space in spaces)
            for spaces in (self._spaces, (public.observation_space, public.action_space))
        )
        if own != there:
            raise PolicyError(f"{self.place} is for observations and actions {own}; the environment has {there}")
