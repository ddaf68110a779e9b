"""Reinforcement learning by Stable-Baselines3 and sb3-contrib as they are: no subclass, no wrapper, only settings."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import torch
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv

from clutter_env.errors import LearningError
from clutter_env.evaluation.score import success_rate
from clutter_env.policies.reinforcement import ALGORITHMS, MODEL_FILE, ModelPolicy, network_name, read_model
from clutter_env.policies.weights import damage_refused, has_weights
from clutter_env.reporting.files import written_atomically
from clutter_env.seeds import held_out_seeds
from clutter_env.training.descent import RunLog
from clutter_env.training.run import Run
from clutter_env.training.settings import Reinforcement

_HINDSIGHT = {
    "replay_buffer_class": HerReplayBuffer,
    "replay_buffer_kwargs": {"n_sampled_goal": 4, "goal_selection_strategy": "future"},
    "learning_rate": 1e-3,
    "gamma": 0.95,
    "learning_starts": 1000,
}
_REACH = {**_HINDSIGHT, "policy_kwargs": {"net_arch": [64, 64]}}
_PICK = {
    **_HINDSIGHT,
    "batch_size": 2048,
    "tau": 0.05,
    "policy_kwargs": {"net_arch": [512, 512, 512], "n_critics": 2},
}
_SKILL_DISCOUNT = 0.97
_BUFFER = 1_000_000
"""Transitions in a replay buffer at most, the default of Stable-Baselines3; hindsight makes a list of that length."""
_OPTIONS: Mapping[tuple[str, ...], Mapping[str, Any]] = MappingProxyType(
    {
        **{(kind, name): _REACH for kind in ("armreach", "reach") for name in ("sac", "tqc")},
        **{(kind, name): _PICK for kind in ("armpick", "pick") for name in ("sac", "tqc")},
        ("retrieve", "sac"): {"learning_starts": 10_000},
        ("retrieve", "tqc"): {"learning_starts": 10_000},
        ("retrieve", "ppo"): {"n_steps": 512, "batch_size": 256},
        ("skill", "ppo"): {"gamma": _SKILL_DISCOUNT, "n_steps": 512, "batch_size": 256},
        ("skill", "maskable_ppo"): {"gamma": _SKILL_DISCOUNT, "n_steps": 512, "batch_size": 256},
        ("skill", "dqn"): {"gamma": _SKILL_DISCOUNT, "learning_starts": 1000, "exploration_fraction": 0.3},
    }
)
"""Options beyond the defaults of Stable-Baselines3, by family of environments and algorithm: in the goal environments
those of RL Baselines3 Zoo for FetchReach-v1 and FetchPickAndPlace-v1, without its normalisation."""


def reinforce(run: Run, resume: bool = False) -> list[dict[str, float]]:
    """Train until `run.settings.steps` in all; the history of the checkpoints.

    A resumed run has networks, optimisers and the number of steps of the last checkpoint, and an empty replay buffer.
    """
    settings = run.settings
    assert isinstance(settings, Reinforcement)
    started, path = time.process_time(), run.directory / MODEL_FILE
    is_resumed = resume and has_weights(path)
    evaluation_env = run.task.make()
    copies = make_vec_env(run.task.make, n_envs=settings.num_envs, seed=run.seed)
    model = make_model(settings, run.task.family, copies, run.seed, run.directory)
    if is_resumed:
        load_model(model, path)
    policy, seeds = ModelPolicy(settings.algorithm, model), held_out_seeds(settings.evaluation_episodes)
    with RunLog(run, is_resumed) as log:

        def checkpoint() -> None:
            success = success_rate(evaluation_env, policy, seeds, settings.evaluation_steps)
            save_model(model, path)
            log.add(steps=model.num_timesteps, success=success, cpu_s=time.process_time() - started)

        left = settings.steps - model.num_timesteps
        if left > 0:
            callback = Checkpoints(settings.checkpoint_every, checkpoint)
            model.learn(left, callback=callback, reset_num_timesteps=False, tb_log_name="tensorboard")
            save_model(model, path)
    copies.close()
    evaluation_env.close()
    return log.history


def make_model(
    settings: Reinforcement, family: str, env: gym.Env | VecEnv, seed: int = 0, log: Path | None = None
) -> BaseAlgorithm:
    """A new model of an algorithm for an environment of a family; it logs to the directory of a run.

    Raises:
        LearningError: there is no such device.
    """
    options = dict(_OPTIONS[family, settings.algorithm])
    if settings.algorithm in ("sac", "tqc", "dqn"):
        options |= {"train_freq": 1, "gradient_steps": settings.gradient_steps}
        options["buffer_size"] = min(_BUFFER, settings.steps)
    network = network_name(env.observation_space)
    try:
        return ALGORITHMS[settings.algorithm](
            network,
            env,
            seed=seed,
            device=settings.device,
            tensorboard_log=None if log is None else str(log),
            **options,
        )
    except RuntimeError as problem:
        raise LearningError(f"no model on device {settings.device!r}: {problem}") from problem


def save_model(model: BaseAlgorithm, path: Path) -> None:
    """Write networks, optimisers and the number of steps; the file is complete, or the old one stays.

    Raises:
        OSError: the disk is full or cannot be written.
    """
    content = {
        "steps": model.num_timesteps,
        "network": {name: value for name, value in model.policy_kwargs.items() if name in ("net_arch", "n_critics")},
        "parameters": model.get_parameters(),
        "log_ent_coef": getattr(model, "log_ent_coef", None),  # learned by SAC and TQC
    }
    with written_atomically(path) as part:
        torch.save(content, part)


def load_model(model: BaseAlgorithm, path: Path) -> None:
    """Give a new model what `save_model` wrote.

    Raises:
        PolicyError: the file is missing or damaged, or it holds the model of another algorithm.
    """
    content = read_model(path)
    with damage_refused(path):
        model.set_parameters(content["parameters"], device=model.device)
        if content["log_ent_coef"] is not None:
            model.log_ent_coef.data.copy_(content["log_ent_coef"])
        model.num_timesteps = int(content["steps"])
    if hasattr(model, "learning_starts"):
        model.learning_starts += model.num_timesteps  # the replay buffer is empty


class Checkpoints(BaseCallback):
    """Calls a function whenever another `every` steps have been learned."""

    def __init__(self, every: int, checkpoint: Callable[[], None]) -> None:
        super().__init__()
        self._every, self._checkpoint = every, checkpoint

    def _on_training_start(self) -> None:
        self._next = (self.num_timesteps // self._every + 1) * self._every

    def _on_step(self) -> bool:
        if self.num_timesteps >= self._next:
            self._next += self._every
            self._checkpoint()
        return True
