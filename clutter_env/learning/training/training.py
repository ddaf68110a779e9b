"""Training runs: one directory each, which holds all that is needed to go on or to act."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import torch
from sb3_contrib import TQC
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from torch.utils.tensorboard import SummaryWriter

from clutter_env.learning.comparison.evaluation import held_out_seeds, success_rate
from clutter_env.learning.demonstrations.dataset import Dataset
from clutter_env.learning.demonstrations.episode import Episode
from clutter_env.learning.demonstrations.experts import make_expert
from clutter_env.learning.errors import LearningError
from clutter_env.learning.policies.agents import CLONERS, POLICY_FILE, model_agent
from clutter_env.learning.policies.policy import Policy
from clutter_env.learning.policies.rl import (
    ALGORITHMS,
    GOAL_ALGORITHMS,
    HISTORY_FILE,
    Checkpoints,
    load_model,
    make_model,
    save_model,
    training_env,
)
from clutter_env.learning.policies.runs import RUN_FILE
from clutter_env.learning.task import Task
from clutter_env.learning.training.bc import CloneConfig, Examples, clone, examples_of
from clutter_env.learning.training.dagger import DaggerConfig, dagger
from clutter_env.learning.training.imitation import BCRegularisation, Imitation, add_demonstrations
from clutter_env.reporting.json_file import write_json

__all__ = ["LEARNERS", "Run", "train"]

LEARNERS = (*ALGORITHMS, *CLONERS)
FAMILIES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        **dict.fromkeys(GOAL_ALGORITHMS, ("reach", "pick")),
        **dict.fromkeys(set(ALGORITHMS) - set(GOAL_ALGORITHMS), ("skill",)),
        **dict.fromkeys(CLONERS, ("retrieve", "reach", "pick")),
    }
)
"""The families of environments that each algorithm learns on."""
DAGGER_SEEDS = 500_000
"""First seed of the learner's own episodes in DAgger."""


@dataclass(frozen=True)
class Run:
    """What to train and how long.

    Attributes:
        task: where to learn.
        algorithm: one of `LEARNERS`.
        steps: of the environment; gradient steps of "bc"; gradient steps per round of "dagger".
        directory: of the run.
        seed: of everything random.
        demonstrations: dataset to learn from; needed by "bc" and "dagger", put in the replay buffer of "sac" and "tqc".
        episodes: of the dataset to use; None for all.
        imitation_steps: gradient steps for which the actor of "sac" and "tqc" first imitates the demonstrations.
        rounds, round_episodes: of "dagger".
        expert: who corrects in "dagger"; "" for the one that the demonstrations are of.
        checkpoint_every: steps between checkpoints; cloning has one at its end, DAgger one after every round.
        evaluation_episodes, evaluation_steps: held-out scenes played at every checkpoint, and where each is cut off.
    """

    task: Task
    algorithm: str
    steps: int
    directory: Path
    seed: int = 0
    demonstrations: Path | None = None
    episodes: int | None = None
    imitation_steps: int = 10_000
    rounds: int = 5
    round_episodes: int = 10
    expert: str = ""
    checkpoint_every: int = 5000
    evaluation_episodes: int = 20
    evaluation_steps: int = 600

    def check(self) -> None:
        """Raise LearningError for a combination that makes no sense."""
        if self.algorithm not in LEARNERS:
            raise LearningError(f"no algorithm {self.algorithm!r}; known ones: {', '.join(LEARNERS)}")
        if self.task.family not in FAMILIES[self.algorithm]:
            fitting = ", ".join(name for name in LEARNERS if self.task.family in FAMILIES[name])
            raise LearningError(f"{self.algorithm} does not learn on {self.task.env_id}; for this one: {fitting}")
        if self.algorithm in CLONERS and self.demonstrations is None:
            raise LearningError(f"{self.algorithm} needs demonstrations: collect some with collect_demos.py")
        if min(self.steps, self.checkpoint_every, self.evaluation_episodes) < 1:
            raise LearningError("steps, checkpoint_every and evaluation_episodes must be at least 1")

    def describe(self) -> dict[str, Any]:
        """What `runs.load_run` will find."""
        task = {"env_id": self.task.env_id, "keywords": dict(self.task.keywords)}
        return {"algorithm": self.algorithm, "task": task, "steps": self.steps, "seed": self.seed}


def train(run: Run, resume: bool = False) -> list[dict[str, float]]:
    """Train; success on held-out scenes after every so many steps.

    Args:
        run: what to train.
        resume: go on from the last checkpoint, if there is one, until `run.steps` in all.

    Raises:
        LearningError: see `Run.check` and `Task.make`; or the directory holds a run already and is not to be resumed.
    """
    run.task.make().close()
    run.check()
    torch.set_num_threads(1)
    if (run.directory / RUN_FILE).exists() and not resume:
        raise LearningError(
            f"{run.directory} holds a training run; --resume goes on with it, or choose another directory"
        )
    run.directory.mkdir(parents=True, exist_ok=True)
    write_json(run.directory / RUN_FILE, run.describe())
    return _clone(run) if run.algorithm in CLONERS else _reinforce(run, resume)


def _reinforce(run: Run, resume: bool) -> list[dict[str, float]]:
    """Stable-Baselines3, with checkpoints."""
    env = training_env(run.algorithm, run.task.make())
    judge = run.task.make()
    is_resumed = resume and (run.directory / "model.zip").exists()
    if is_resumed:
        model = load_model(run.algorithm, run.directory, env, with_buffer=True)
        model.tensorboard_log = str(run.directory)
    else:
        has_demonstrations = run.demonstrations is not None
        model = make_model(run.algorithm, env, run.seed, run.directory, has_demonstrations)
    callbacks: list[BaseCallback] = []
    if run.demonstrations is not None and isinstance(model, SAC | TQC):
        callbacks.append(_take_demonstrations(run, model, env, is_new=not is_resumed))

    def evaluate(model: Any) -> dict[str, float]:
        return {"success": _success(run, judge, model_agent(run.algorithm, model, judge))}

    checkpoints = Checkpoints(run.directory, run.checkpoint_every, evaluate)
    left = run.steps - model.num_timesteps
    if left > 0:
        model.learn(
            left, callback=CallbackList([*callbacks, checkpoints]), reset_num_timesteps=False, tb_log_name="tensorboard"
        )
        save_model(model, run.directory)
    env.close()
    judge.close()
    return checkpoints.history


def _take_demonstrations(run: Run, model: SAC | TQC, env: gym.Env, is_new: bool) -> BCRegularisation:
    """Fill a new model's replay buffer and let its actor begin with what the demonstrations do."""
    episodes = _episodes(run)
    imitation = Imitation(model, env, episodes)
    if is_new:
        add_demonstrations(model, env, episodes)
        imitation.begin(run.imitation_steps)
    return BCRegularisation(imitation, run.steps)


def _clone(run: Run) -> list[dict[str, float]]:
    """Behaviour cloning or DAgger; begins anew when resumed, since it is short."""
    assert run.demonstrations is not None
    env = run.task.make()
    examples = examples_of(_episodes(run))
    history: list[dict[str, float]] = []
    config = CloneConfig(steps=run.steps, seed=run.seed)
    with SummaryWriter(str(run.directory / "tensorboard")) as writer:

        def report_loss(step: int, loss: float) -> None:
            writer.add_scalar("train/loss", loss, step)

        def report_round(index: int, policy: Policy, examples: Examples) -> None:
            policy.save(run.directory / POLICY_FILE)
            history.append({"round": index, "examples": len(examples), "success": _success(run, env, policy.act)})
            write_json(run.directory / HISTORY_FILE, history)
            for name, value in history[-1].items():
                writer.add_scalar(f"held_out/{name}", value, index)

        if run.algorithm == "bc":
            report_round(0, clone(examples, config, report=report_loss), examples)
        else:
            expert = make_expert(env, run.expert or str(Dataset(run.demonstrations).identity["expert"]))
            first = DAGGER_SEEDS + run.seed * run.rounds * run.round_episodes
            seeds: Sequence[int] = range(first, first + run.rounds * run.round_episodes)
            rounds = DaggerConfig(run.rounds, run.round_episodes, config)
            dagger(env, expert, examples, seeds, rounds, report_round)
    env.close()
    return history


def _success(run: Run, env: gym.Env, act: Callable[[Any], Any]) -> float:
    """Success on the held-out scenes."""
    return success_rate(env, act, held_out_seeds(run.evaluation_episodes), run.evaluation_steps)


def _episodes(run: Run) -> list[Episode]:
    assert run.demonstrations is not None
    dataset = Dataset(run.demonstrations)
    identity = dataset.identity["task"]
    if identity["env_id"] != run.task.env_id:
        raise LearningError(
            f"{run.demonstrations} holds demonstrations of {identity['env_id']}, not of {run.task.env_id}"
        )
    there, here = identity["keywords"].get("control_mode"), run.task.keywords.get("control_mode")
    if there != here:
        raise LearningError(
            f"{run.demonstrations} was collected with control_mode={there!r}, and this is {here!r} (None: the default)"
        )
    return list(dataset)[: run.episodes]
