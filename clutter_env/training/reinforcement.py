"""Reinforcement learning with Stable-Baselines3, saved completely at every checkpoint, and resumed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import torch
from numpy.typing import NDArray
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from clutter_env.evaluation.score import success_rate
from clutter_env.policies.reinforcement import ALGORITHMS, MODEL_FILE, NETWORKS, ModelPolicy, space_shape, training_env
from clutter_env.policies.runs import GOAL_ALGORITHMS
from clutter_env.policies.weights import damage_refused, has_arrays, read_arrays, tensors, write_arrays
from clutter_env.seeds import held_out_seeds
from clutter_env.training.descent import RunLog
from clutter_env.training.run import Run
from clutter_env.training.settings import PPO, SAC
from clutter_env.training.skills import clone_skills

BUFFER_FILE = "replay_buffer.npz"
"""The replay buffer, in the directory of a run."""
_ROWS = ("actions", "rewards", "dones", "timeouts", "ep_start", "ep_length")
_COUNTERS = ("num_timesteps", "_n_updates", "_episode_num")
_EPISODES = ("ep_info_buffer", "ep_success_buffer")
"""Of a model: the last episodes, whose means are logged."""
_ENTROPY = "log_ent_coef"
"""Logarithm of the coefficient of the entropy, which is learned."""


def _falling_rate(share_left: float) -> float:
    """The learning rate for the share of the run that is left; zero at the end, so that the weights settle."""
    return 1e-3 * share_left


_OFF_POLICY: Mapping[str, Any] = MappingProxyType(
    {
        "replay_buffer_class": HerReplayBuffer,
        "replay_buffer_kwargs": {"n_sampled_goal": 4, "goal_selection_strategy": "future"},
        "learning_rate": _falling_rate,
        "ent_coef": "auto_0.1",
        "batch_size": 256,
        "gamma": 0.95,
        "tau": 0.02,
        "learning_starts": 500,
        "buffer_size": 300_000,
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
    is_resumed = resume and has_arrays(run.directory / MODEL_FILE)
    model = make_model(name, env, run.seed, run.directory, clones)
    if is_resumed:
        load_model(model, run.directory)
    policy, seeds = ModelPolicy(name, model), held_out_seeds(settings.evaluation_episodes)
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
    network, keywords = NETWORKS[name]
    options = _OFF_POLICY if name in GOAL_ALGORITHMS else _IMPROVING if improves_clone else _FROM_NOTHING
    return ALGORITHMS[name](
        policy=network,
        env=env,
        policy_kwargs=dict(keywords),
        seed=seed,
        device="cpu",
        tensorboard_log=None if log is None else str(log),
        **options,
    )


def save_model(model: BaseAlgorithm, directory: Path) -> None:
    """Write model and replay buffer as arrays of numbers; each file is complete, or the old one stays.

    Raises:
        OSError: the disk is full or cannot be written.
    """
    if isinstance(model, OffPolicyAlgorithm):
        buffer: Any = model.replay_buffer
        rows = {name: values[: buffer.size()] for name, values in _buffer_arrays(buffer).items()}
        about = {"pos": buffer.pos, "full": buffer.full, "episode_start": buffer._current_ep_start}
        write_arrays(directory / BUFFER_FILE, rows, about)
    arrays: dict[str, NDArray[Any]] = {}
    for name, part in model.get_parameters().items():
        # Of an optimiser its state for each parameter; its settings are made anew.
        states = {f"{name}/{index}": state for index, state in part.get("state", {}).items()}
        for path, values in (states if "param_groups" in part else {name: part}).items():
            arrays |= {f"{path}/{key}": value.numpy() for key, value in values.items()}
    if isinstance(model, OffPolicyAlgorithm):
        arrays[_ENTROPY] = model.log_ent_coef.detach().numpy()
    write_arrays(
        directory / MODEL_FILE,
        arrays,
        {
            "observation": space_shape(model.observation_space),
            "action": space_shape(model.action_space),
            "counters": {name: getattr(model, name) for name in _COUNTERS},
            **{name: list(getattr(model, name) or ()) for name in _EPISODES},
        },
    )


def load_model(model: BaseAlgorithm, directory: Path) -> None:
    """Give a new model what `save_model` wrote; it goes on as the saved one, from the start of an episode.

    Raises:
        PolicyError: a file is missing or damaged, or another version of this package wrote it.
    """
    path = directory / MODEL_FILE
    arrays, about = read_arrays(path)
    with damage_refused(path):
        parameters = model.get_parameters()
        for name, part in parameters.items():
            own = tensors(arrays, f"{name}/")
            if "param_groups" not in part:
                parameters[name] = own
                continue
            for key, value in own.items():
                index, _, entry = key.partition("/")
                part["state"].setdefault(int(index), {})[entry] = value
        model.set_parameters(parameters, device="cpu")
        if isinstance(model, OffPolicyAlgorithm):
            model.log_ent_coef.data.copy_(torch.from_numpy(arrays[_ENTROPY]))
        for name in _COUNTERS:
            setattr(model, name, int(about["counters"][name]))
        for name in _EPISODES:
            setattr(model, name, deque(about[name], maxlen=model._stats_window_size))
    if not isinstance(model, OffPolicyAlgorithm):
        return
    path = directory / BUFFER_FILE
    arrays, about = read_arrays(path)
    with damage_refused(path):
        buffer: Any = model.replay_buffer
        for name, rows in _buffer_arrays(buffer).items():
            rows[: len(arrays[name])] = arrays[name]
        buffer.pos, buffer.full = int(about["pos"]), bool(about["full"])
        buffer._current_ep_start[:] = about["episode_start"]
        buffer.truncate_last_trajectory()


def _buffer_arrays(buffer: HerReplayBuffer) -> dict[str, NDArray[Any]]:
    """The arrays of a replay buffer, one row a step."""
    found = {name: getattr(buffer, name) for name in _ROWS}
    for name in ("observations", "next_observations"):
        found |= {f"{name}/{key}": values for key, values in getattr(buffer, name).items()}
    return found


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
