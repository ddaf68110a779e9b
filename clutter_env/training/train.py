"""Training from rewards with Stable-Baselines3 and sb3-contrib as they are, without subclasses and wrappers.

A run has its own directory, with all data needed to resume it or to use its policy.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import torch
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import ConvertCallback, EveryNTimesteps
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv

from clutter_env.errors import LearningError
from clutter_env.evaluation.score import success_rate
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.policies.reinforcement import ALGORITHMS, MODEL_FILE, ModelPolicy, network_name, read_model
from clutter_env.policies.runs import HISTORY_FILE
from clutter_env.policies.weights import damage_refused
from clutter_env.reporting.files import write_json, written_atomically
from clutter_env.reporting.progress import progress_bar
from clutter_env.seeds import held_out_seeds
from clutter_env.training.run import Run
from clutter_env.training.settings import Settings

History = list[dict[str, float]]

_OFF_POLICY = ("sac", "tqc", "dqn")
_UPDATE_S = 0.03
"""[s] Time of an update and its step, measured for TQC on ArmReach."""
_HINDSIGHT = {
    "replay_buffer_class": HerReplayBuffer,
    "replay_buffer_kwargs": {"n_sampled_goal": 4, "goal_selection_strategy": "future"},
    "learning_rate": 1e-3,
    "gamma": 0.95,
    "learning_starts": 1000,
}
_REACH = {**_HINDSIGHT, "policy_kwargs": {"net_arch": [64, 64]}}
_PICK = {**_HINDSIGHT, "batch_size": 2048, "tau": 0.05, "policy_kwargs": {"net_arch": [512, 512, 512], "n_critics": 2}}
_STAGED = {
    "learning_rate": 1e-3,
    "gamma": 0.95,
    "tau": 0.01,
    "learning_starts": 1000,
    "ent_coef": "auto_0.1",
    "target_entropy": -2.0,  # half of the default, otherwise the fingers stay still, see docs/train_your_own.md
    "policy_kwargs": {"net_arch": [128, 128]},
}
_EPISODE = 100
"""[steps] Longest episode of the goal environments. Hindsight learns from whole episodes of all copies."""
_SKILL_DISCOUNT = 0.97
_BUFFER = 1_000_000
"""Most transitions in a replay buffer, the default of Stable-Baselines3. Hindsight makes a list of that length."""
_OPTIONS: Mapping[tuple[str, ...], Mapping[str, Any]] = MappingProxyType(
    {
        **{(kind, name): _REACH for kind in ("armreach", "reach") for name in ("sac", "tqc")},
        **{(kind, name): _PICK for kind in ("armpick", "pick") for name in ("sac", "tqc")},
        ("armretrieve", "sac"): _STAGED,
        ("armretrieve", "tqc"): _STAGED,
        ("armretrieve", "ppo"): {"gamma": 0.95, "n_steps": 512, "batch_size": 256},
        ("retrieve", "sac"): {"learning_starts": 10_000},
        ("retrieve", "tqc"): {"learning_starts": 10_000},
        ("retrieve", "ppo"): {"n_steps": 512, "batch_size": 256},
        ("skill", "ppo"): {"gamma": _SKILL_DISCOUNT, "n_steps": 512, "batch_size": 256},
        ("skill", "maskable_ppo"): {"gamma": _SKILL_DISCOUNT, "n_steps": 512, "batch_size": 256},
        ("skill", "dqn"): {"gamma": _SKILL_DISCOUNT, "learning_starts": 1000, "exploration_fraction": 0.3},
    }
)
"""Options beyond the defaults of Stable-Baselines3, by family of environments and algorithm. The goal environments use
those of RL Baselines3 Zoo for FetchReach-v1 and FetchPickAndPlace-v1, without its normalisation."""


@dataclass(frozen=True)
class Trained:
    """A run that has ended: its history (success on held-out scenes), wall time [s] and CPU time [s]."""

    history: History
    wall_s: float
    cpu_s: float


def train(run: Run, resume: bool = False) -> Trained:
    """Train in this process.

    Args:
        run: the run to train.
        resume: continue from the last checkpoint, if it exists, until `run.settings.steps` in all. Networks, optimisers
            and number of steps are those of the checkpoint, and the replay buffer is empty.

    Raises:
        LearningError: see `Run.check`, before anything is written. Or the disk is full or cannot be written, and the
            last complete checkpoint stays.
        PolicyError: the checkpoint to continue from is damaged.
    """
    started, started_cpu = time.perf_counter(), time.process_time()
    run.check(resume)
    # The networks are small, so more threads are slower. Also, several runs share a machine.
    torch.set_num_threads(1)
    try:
        run.write_record()
        history = _learn(run, resume and (run.directory / MODEL_FILE).exists())
    except OSError as problem:
        raise LearningError(
            f"training had to stop: {problem}; the last complete checkpoint in {run.directory} stays, and --resume "
            "goes on from there"
        ) from problem
    return Trained(history, time.perf_counter() - started, time.process_time() - started_cpu)


def train_all(
    runs: Sequence[Run],
    workers: int,
    resume: bool = False,
    ray: str = "",
    report: Callable[[Run, Trained], None] = lambda *_: None,
) -> list[Trained]:
    """Train all runs: one in this process, several in parallel.

    Args:
        runs: each with its own directory. All are checked before the first starts.
        workers: number of runs trained at a time.
        resume: continue from their last checkpoints.
        ray: address of Ray, empty for processes of this machine.
        report: called with each run as it ends.

    Raises:
        LearningError: see `Run.check`. Or runs crashed, raised after the others have ended.
    """
    for run in runs:
        run.check(resume)
    if len(runs) == 1:
        only = train(runs[0], resume)
        report(runs[0], only)
        return [only]
    trained, crashed = {}, []
    for run, result in run_jobs(partial(train, resume=resume), runs, workers, ray=ray):
        if isinstance(result, Crash | Killed):
            crashed.append(f"{run.directory}: {result.detail}")
        else:
            trained[run.directory] = result
            report(run, result)
    if crashed:
        raise LearningError("; ".join(crashed))
    return [trained[run.directory] for run in runs]


def _learn(run: Run, is_resumed: bool) -> History:
    """Train until `run.settings.steps` in all. Return the history, which is written as it grows, also to
    TensorBoard."""
    settings, path, history_file = run.settings, run.directory / MODEL_FILE, run.directory / HISTORY_FILE
    started, history = time.process_time(), History()
    evaluation_env = run.task.make()
    copies = make_vec_env(run.task.make, n_envs=settings.num_envs, seed=run.seed)
    model = make_model(run.algorithm, settings, run.task.family, copies, run.seed, run.directory)
    if is_resumed:
        load_model(model, path)
        if history_file.exists():
            with damage_refused(history_file):
                history = [dict(entry) for entry in json.loads(history_file.read_text())]
    policy, seeds = ModelPolicy(run.algorithm, model), held_out_seeds(settings.evaluation_episodes)

    def checkpoint(*_: object) -> bool:
        """Measure success and save. Return True, so that training continues."""
        success = success_rate(evaluation_env, policy, seeds, settings.evaluation_steps)
        save_model(model, path)
        history.append({"steps": model.num_timesteps, "success": success, "cpu_s": time.process_time() - started})
        write_json(history_file, history)
        model.logger.record("held_out/success", success)
        model.logger.dump(model.num_timesteps)
        return True

    left = settings.steps - model.num_timesteps
    if left > 0:
        checkpoints = EveryNTimesteps(settings.checkpoint_every, ConvertCallback(checkpoint))
        checkpoints.last_time_trigger = model.num_timesteps
        updates = left * settings.gradient_steps / settings.num_envs
        seconds = _UPDATE_S * updates if run.algorithm in _OFF_POLICY else 0.0
        with progress_bar(total=settings.steps, initial=model.num_timesteps, unit="step", seconds=seconds) as bar:
            shown = ConvertCallback(lambda *_: bar.update(model.num_timesteps - bar.n) or True)
            model.learn(left, callback=[checkpoints, shown], reset_num_timesteps=False, tb_log_name="tensorboard")
        if history and history[-1]["steps"] == model.num_timesteps:
            save_model(model, path)  # PPO has learned from the last steps since the last checkpoint
        else:
            checkpoint()
    copies.close()
    evaluation_env.close()
    return history


def make_model(
    algorithm: str, settings: Settings, family: str, env: gym.Env | VecEnv, seed: int = 0, log: Path | None = None
) -> BaseAlgorithm:
    """Make a model of an algorithm for an environment of a family. It logs to the directory of a run.

    Raises:
        LearningError: the device does not exist.
    """
    options = dict(_OPTIONS[family, algorithm])
    if algorithm in _OFF_POLICY:
        options |= {"train_freq": 1, "gradient_steps": settings.gradient_steps}
        options["buffer_size"] = min(_BUFFER, settings.steps)
    if "replay_buffer_class" in options:
        options["learning_starts"] = max(options["learning_starts"], _EPISODE * settings.num_envs)
    network, log_directory = network_name(env.observation_space), None if log is None else str(log)
    try:
        return ALGORITHMS[algorithm](
            network, env, seed=seed, device=settings.device, tensorboard_log=log_directory, **options
        )
    except RuntimeError as problem:
        raise LearningError(f"no model on device {settings.device!r}: {problem}") from problem


def save_model(model: BaseAlgorithm, path: Path) -> None:
    """Write networks, optimisers and the number of steps. The file is either complete or the old file stays.

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
    """Load the data of `save_model` into a new model.

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
