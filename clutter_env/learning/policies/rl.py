"""Reinforcement learning with Stable-Baselines3: models are made, saved completely, and resumed."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from sb3_contrib import TQC, MaskablePPO
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from clutter_env.learning.errors import LearningError
from clutter_env.learning.policies.corrections import CorrectedActions
from clutter_env.learning.policies.critics import NormalisedSACPolicy, NormalisedTQCPolicy
from clutter_env.learning.policies.features import (
    COS_YAW,
    NEAR_SCALES,
    OBJECT_ROW,
    OBJECTS_FROM,
    SIN_YAW,
    TCP_POSITION,
)
from clutter_env.learning.policies.policy import Policy
from clutter_env.learning.policies.priced import PricedReplayBuffer
from clutter_env.learning.policies.priced_critics import PricedSACPolicy, PricedTQCPolicy
from clutter_env.learning.policies.runs import GOAL_ALGORITHMS
from clutter_env.learning.policies.skill_policy import MaskableSkillPolicy, SkillPolicy
from clutter_env.learning.policies.symmetric import SymmetricReplayBuffer
from clutter_env.reporting.files import write_atomically, write_json, written_atomically

__all__ = [
    "ALGORITHMS",
    "GRIPPER_SCALE",
    "Checkpoints",
    "GoalFeatures",
    "ScaledActions",
    "acting_part",
    "load_model",
    "make_model",
    "save_model",
    "training_env",
]

ALGORITHMS: Mapping[str, type[BaseAlgorithm]] = MappingProxyType(
    {"sac": SAC, "tqc": TQC, "ppo": PPO, "maskable_ppo": MaskablePPO}
)
"""By name: the classes of `GOAL_ALGORITHMS` and `SKILL_ALGORITHMS`."""
HISTORY_FILE = "history.json"
_MODEL, _BUFFER = "model.zip", "replay_buffer.pkl"

BASE_SCALE, TURN_SCALE = 0.1, 0.2
"""Shares of the greatest velocity of the base, and of the greatest turning rate of the gripper, that a full action of a
learner commands. Goals are within the arm's reach; at full speed the noise of exploration drives the base away."""
GRIPPER_SCALE = 0.5
"""Share of the greatest velocity of the gripper that a full action commands of a learner without an imitation. At full
speed the commanded pose, which is not observed, leads the arm by up to 5 cm, and the arm swings where it is folded."""


class ScaledActions(gym.ActionWrapper[Any, Any, Any]):
    """Scales the actions of a learner without an imitation, so that base and gripper turn and move more slowly."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        self.scale = _action_scale(env)
        if env.get_wrapper_attr("control_mode") == "ee":
            self.scale[3:6] = GRIPPER_SCALE

    def action(self, action: Any) -> Any:
        """The environment's action for an action of the learner."""
        return action * self.scale

    def reverse_action(self, action: Any) -> Any:
        """The action of the learner for an action of the environment, clipped to its range."""
        return np.clip(action / self.scale, -1.0, 1.0)


def training_env(name: str, env: gym.Env, imitation: Policy | None = None) -> gym.Env:
    """The environment as a learner sees it: with the action scale of its algorithm, and the imitation it corrects."""
    if name not in GOAL_ALGORITHMS:
        return env
    return ScaledActions(env) if imitation is None else CorrectedActions(env, imitation, _action_scale(env))


def _action_scale(env: gym.Env) -> NDArray[np.float32]:
    scale = np.ones(env.action_space.shape or (), np.float32)
    scale[:3] = BASE_SCALE
    if env.get_wrapper_attr("control_mode") == "ee":
        scale[6:9] = TURN_SCALE
    return scale


class GoalFeatures(BaseFeaturesExtractor):
    """`features.feature_vector` of a goal observation, for batches on torch."""

    def __init__(self, space: gym.spaces.Dict) -> None:
        (size,) = space["observation"].shape or (0,)
        offsets = 1 + (size > OBJECTS_FROM)
        super().__init__(space, size + offsets * 3 * (1 + len(NEAR_SCALES)))

    def forward(self, observation: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Features (k, f) of observations with entries (k, n)."""
        vector = observation["observation"].float()
        offset = (observation["desired_goal"] - observation["achieved_goal"]).float()
        sine, cosine = vector[:, SIN_YAW], vector[:, COS_YAW]
        ahead = cosine * offset[:, 0] + sine * offset[:, 1]
        left = cosine * offset[:, 1] - sine * offset[:, 0]
        parts = [vector, *_near_and_far(torch.stack((ahead, left, offset[:, 2]), dim=1))]
        if vector.shape[1] > OBJECTS_FROM:
            rows = vector[:, OBJECTS_FROM:].reshape(len(vector), -1, OBJECT_ROW.size)
            target = (rows[:, :, OBJECT_ROW["position"]] * rows[:, :, OBJECT_ROW["is_target"]]).sum(1)
            parts += _near_and_far(target - vector[:, TCP_POSITION])
        return torch.cat(parts, dim=1)


def _near_and_far(offset: torch.Tensor) -> list[torch.Tensor]:
    return [2 * offset, *(torch.tanh(scale * offset) for scale in NEAR_SCALES)]


def make_model(name: str, env: gym.Env, seed: int, log: Path | None = None, has_clone: bool = False) -> BaseAlgorithm:
    """A new model for an environment from `training_env`.

    Args:
        name: of the algorithm.
        env: where it will learn.
        seed: random seed.
        log: directory for TensorBoard.
        has_clone: whether it improves a clone. SAC and TQC then correct one in an environment with `CorrectedActions`:
            the actor starts as the clone and explores little, and half of the data will be demonstrations. PPO and
            MaskablePPO then learn in smaller steps, for a network that will be fitted to labels first.

    Raises:
        LearningError: no such algorithm; the message lists the known ones.
    """
    if name not in ALGORITHMS:
        raise LearningError(f"no algorithm {name!r}; known ones: {', '.join(ALGORITHMS)}")
    common: dict[str, Any] = {
        "env": env,
        "seed": seed,
        "device": "cpu",
        "tensorboard_log": None if log is None else str(log),
    }
    if name not in GOAL_ALGORITHMS:
        policy = MaskableSkillPolicy if name == "maskable_ppo" else SkillPolicy
        return ALGORITHMS[name](policy, **(_IMPROVING if has_clone else _FROM_NOTHING), **common)
    if not has_clone:
        return ALGORITHMS[name](PricedSACPolicy if name == "sac" else PricedTQCPolicy, **_OFF_POLICY, **common)
    correcting = NormalisedSACPolicy if name == "sac" else NormalisedTQCPolicy
    model = ALGORITHMS[name](correcting, replay_buffer_class=SymmetricReplayBuffer, **_CORRECTING, **common)
    _begin_with_small_corrections(model.policy.actor)
    return model


def save_model(model: BaseAlgorithm, directory: Path) -> None:
    """Write model and replay buffer; each file is complete, or the old one stays.

    Raises:
        OSError: the disk is full or cannot be written.
    """
    directory.mkdir(parents=True, exist_ok=True)
    content = BytesIO()
    model.save(content)
    if isinstance(model, OffPolicyAlgorithm):
        with written_atomically(directory / _BUFFER) as part, part.open("wb") as file:
            model.save_replay_buffer(file)
    write_atomically(directory / _MODEL, content.getvalue())


def load_model(name: str, directory: Path, env: gym.Env, with_buffer: bool = False) -> BaseAlgorithm:
    """The model that `save_model` wrote; with its replay buffer it is ready to go on learning.

    Raises:
        LearningError: there is none.
    """
    path = directory / _MODEL
    if not path.exists():
        raise LearningError(f"there is no model in {directory}")
    model = ALGORITHMS[name].load(path, env=env, device="cpu")
    if with_buffer and isinstance(model, OffPolicyAlgorithm):
        model.load_replay_buffer(directory / _BUFFER, truncate_last_traj=True)
    return model


class Checkpoints(BaseCallback):
    """Evaluates and saves the model at regular intervals; continues the history of an interrupted run.

    Both happen within `in_place`, which may put other weights in the model meanwhile.
    """

    def __init__(
        self,
        directory: Path,
        every: int,
        evaluate: Callable[[BaseAlgorithm], Mapping[str, float]],
        in_place: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        super().__init__()
        self._directory, self._every, self._evaluate, self._in_place = directory, every, evaluate, in_place
        self._next = every
        path = directory / HISTORY_FILE
        self.history: list[dict[str, float]] = json.loads(path.read_text()) if path.exists() else []

    def _on_training_start(self) -> None:
        self._next = (self.num_timesteps // self._every + 1) * self._every

    def _on_step(self) -> bool:
        if self.num_timesteps >= self._next:
            self._next += self._every
            with self._in_place():
                self.history.append({"steps": self.num_timesteps, **self._evaluate(self.model)})
                save_model(self.model, self._directory)
            for name, value in self.history[-1].items():
                self.logger.record(f"held_out/{name}", value)
            write_json(self._directory / HISTORY_FILE, self.history)
        return True


def _falling_rate(share_left: float) -> float:
    """The learning rate for the share of the run that is left; zero at the end, so that the weights settle."""
    return 1e-3 * share_left


def _falling_rate_of_corrections(share_left: float) -> float:
    """The same for a learner that corrects an imitation."""
    return 6e-4 * share_left


_OFF_POLICY: Mapping[str, Any] = MappingProxyType(
    {
        "replay_buffer_class": PricedReplayBuffer,
        "replay_buffer_kwargs": {"n_sampled_goal": 4, "goal_selection_strategy": "future"},
        "learning_rate": _falling_rate,
        "ent_coef": "auto_0.1",
        "batch_size": 256,
        "gamma": 0.95,
        "tau": 0.02,
        "learning_starts": 500,
        "buffer_size": 300_000,
        "policy_kwargs": {"net_arch": [128, 128], "features_extractor_class": GoalFeatures},
    }
)
"""SAC and TQC from rewards alone, with hindsight. The coefficient of the entropy begins at 0.1: at 1 the values are
those of the entropy alone for the first 3,000 steps."""
_CORRECTING: Mapping[str, Any] = MappingProxyType(
    {
        "learning_rate": _falling_rate_of_corrections,
        "target_entropy": -1.0,
        "ent_coef": "auto_0.05",
        "batch_size": 256,
        "gamma": 0.85,
        "tau": 0.01,
        "learning_starts": 200,
        "gradient_steps": 1,
        "buffer_size": 60_000,
        "policy_kwargs": {"net_arch": [128, 128], "optimizer_kwargs": {"fused": True}},
    }
)
"""SAC and TQC that correct an imitation. The discount is short, 2.7 s: what comes later the imitation knows. With this
entropy corrections keep a standard deviation of 0.2, so that the critics go on seeing what they are worth."""
_FIRST_DEVIATION = 0.5
"""Initial standard deviation of corrections, before tanh squashes them into [-1, 1]."""


def _begin_with_small_corrections(actor: Any) -> None:
    """Start with the imitation itself, and small deviations from it."""
    for layer, bias in ((actor.mu, 0.0), (actor.log_std, math.log(_FIRST_DEVIATION))):
        torch.nn.init.zeros_(layer.weight)
        torch.nn.init.constant_(layer.bias, bias)


_SKILLS: Mapping[str, Any] = MappingProxyType({"n_steps": 512, "batch_size": 128, "gamma": 0.97})
_FROM_NOTHING: Mapping[str, Any] = MappingProxyType({**_SKILLS, "learning_rate": 1e-3, "n_epochs": 6, "ent_coef": 0.01})
"""PPO and MaskablePPO from rewards alone."""
_IMPROVING: Mapping[str, Any] = MappingProxyType(
    {**_SKILLS, "n_steps": 1024, "learning_rate": 1e-4, "n_epochs": 4, "target_kl": 0.02}
)
"""PPO and MaskablePPO that improve a clone."""


def acting_part(model: BaseAlgorithm) -> torch.nn.Module:
    """The weights of a model that choose its actions: the actor of SAC and TQC, the whole policy of PPO."""
    part: torch.nn.Module = getattr(model.policy, "actor", model.policy)
    return part
