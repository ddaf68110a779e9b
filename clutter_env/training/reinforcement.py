"""Reinforcement learning with Stable-Baselines3, saved completely at every checkpoint, and resumed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium as gym
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from clutter_env.evaluation.score import held_out_seeds, success_rate
from clutter_env.policies.reinforcement import (
    ALGORITHMS,
    BUFFER_FILE,
    MODEL_FILE,
    GoalFeatures,
    MaskableSkillPolicy,
    ModelPolicy,
    SkillPolicy,
    load_model,
    training_env,
)
from clutter_env.policies.runs import GOAL_ALGORITHMS
from clutter_env.reporting.files import write_atomically, written_atomically
from clutter_env.training.descent import RunLog
from clutter_env.training.run import Run
from clutter_env.training.settings import PPO, SAC
from clutter_env.training.skills import clone_skills


def _falling_rate(share_left: float) -> float:
    """The learning rate for the share of the run that is left; zero at the end, so that the weights settle."""
    return 1e-3 * share_left


_OFF_POLICY: Mapping[str, Any] = MappingProxyType(
    {
        "policy": "MultiInputPolicy",
        "replay_buffer_class": HerReplayBuffer,
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
"""SAC and TQC with hindsight. The coefficient of the entropy begins at 0.1: at 1 the values are those of the entropy
alone for the first 3,000 steps."""
_SKILLS: Mapping[str, Any] = MappingProxyType({"n_steps": 512, "batch_size": 128, "gamma": 0.97})
_FROM_NOTHING: Mapping[str, Any] = MappingProxyType({**_SKILLS, "learning_rate": 1e-3, "n_epochs": 6, "ent_coef": 0.01})
"""PPO and MaskablePPO from rewards alone."""
_IMPROVING: Mapping[str, Any] = MappingProxyType(
    {**_SKILLS, "n_steps": 1024, "learning_rate": 1e-4, "n_epochs": 4, "target_kl": 0.02}
)
"""PPO and MaskablePPO that improve a clone: smaller steps."""


def reinforce(run: Run, resume: bool = False) -> list[dict[str, float]]:
    """Train until `run.settings.steps` in all; the history of the checkpoints."""
    settings = run.settings
    assert isinstance(settings, SAC | PPO)
    name, clones = settings.algorithm, isinstance(settings, PPO) and settings.clone_scenes > 0
    evaluation_env, env = run.task.make(), training_env(name, run.task.make())
    is_resumed = resume and (run.directory / MODEL_FILE).exists()
    if is_resumed:
        model = load_model(name, run.directory, env, with_buffer=True)
        model.tensorboard_log = str(run.directory)
    else:
        model = make_model(name, env, run.seed, run.directory, clones)
    policy, seeds = ModelPolicy(name, model, evaluation_env), held_out_seeds(settings.evaluation_episodes)
    with RunLog(run, is_resumed) as log:

        def checkpoint() -> None:
            success = success_rate(evaluation_env, policy, seeds, settings.evaluation_steps)
            save_model(model, run.directory)
            log.add(steps=model.num_timesteps, success=success)

        if isinstance(settings, PPO) and clones and not is_resumed:
            clone_skills(run, settings, model, log)
            checkpoint()
        left = settings.steps - model.num_timesteps
        if left > 0:
            callback = Checkpoints(settings.checkpoint_every, checkpoint)
            model.learn(left, callback=callback, reset_num_timesteps=False, tb_log_name="tensorboard")
            save_model(model, run.directory)
    env.close()
    evaluation_env.close()
    return log.history


def make_model(
    name: str, env: gym.Env, seed: int, log: Path | None = None, improves_clone: bool = False
) -> BaseAlgorithm:
    """A new model of an algorithm for an environment from `training_env`; it logs to the directory of a run.

    PPO and MaskablePPO that improve a clone learn in smaller steps.
    """
    options: Mapping[str, Any] = _OFF_POLICY
    if name not in GOAL_ALGORITHMS:
        policy = MaskableSkillPolicy if name == "maskable_ppo" else SkillPolicy
        options = {"policy": policy, **(_IMPROVING if improves_clone else _FROM_NOTHING)}
    tensorboard = None if log is None else str(log)
    return ALGORITHMS[name](env=env, seed=seed, device="cpu", tensorboard_log=tensorboard, **options)


def save_model(model: BaseAlgorithm, directory: Path) -> None:
    """Write model and replay buffer; each file is complete, or the old one stays.

    Raises:
        OSError: the disk is full or cannot be written.
    """
    directory.mkdir(parents=True, exist_ok=True)
    content = BytesIO()
    model.save(content)
    if isinstance(model, OffPolicyAlgorithm):
        with written_atomically(directory / BUFFER_FILE) as part, part.open("wb") as file:
            model.save_replay_buffer(file)
    write_atomically(directory / MODEL_FILE, content.getvalue())


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
