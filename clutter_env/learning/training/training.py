"""Training: one directory per run, with all that is needed to resume it, or to act with its policy."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import torch
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from torch.utils.tensorboard import SummaryWriter

from clutter_env.learning.comparison.evaluation import held_out_seeds, success_rate
from clutter_env.learning.demonstrations.dataset import Dataset
from clutter_env.learning.demonstrations.episode import Episode
from clutter_env.learning.demonstrations.experts import make_expert
from clutter_env.learning.errors import LearningError
from clutter_env.learning.policies.agents import POLICY_FILE, model_agent
from clutter_env.learning.policies.chosen import consider, forget_chosen
from clutter_env.learning.policies.corrections import CorrectedActions
from clutter_env.learning.policies.policy import Policy
from clutter_env.learning.policies.rl import (
    HISTORY_FILE,
    Checkpoints,
    acting_part,
    load_model,
    make_model,
    save_model,
    training_env,
)
from clutter_env.learning.policies.runs import (
    CLONERS,
    DECISION_LEARNERS,
    GOAL_ALGORITHMS,
    MOVER_LEARNERS,
    SKILL_ALGORITHMS,
)
from clutter_env.learning.task import HELD_OUT
from clutter_env.learning.training.averaging import AveragedActor
from clutter_env.learning.training.bc import CloneConfig, Examples, clone, examples_of
from clutter_env.learning.training.critics_first import CriticsFirst
from clutter_env.learning.training.dagger import DaggerConfig, dagger
from clutter_env.learning.training.decisions import train_decisions
from clutter_env.learning.training.movers import train_mover
from clutter_env.learning.training.run import Run
from clutter_env.learning.training.skills import clone_skills
from clutter_env.reporting.files import write_json

__all__ = ["Trained", "train"]

CRITICS_ALONE = 1000
"""Steps of the environment during which a learner that corrects an imitation keeps to the imitation."""
DAGGER_SEEDS = 500_000
"""First seed of the learner's own episodes in DAgger."""
VALIDATION_SEEDS = 3_000_000
"""First seed of the scenes on which the weights of a run are chosen: held-out scenes are for measurements alone."""


@dataclass(frozen=True)
class Trained:
    """A run that has ended: its history (success on held-out scenes), wall time [s] and CPU time [s]."""

    history: list[dict[str, float]]
    wall_s: float
    cpu_s: float


def train(run: Run, resume: bool = False) -> Trained:
    """Train in this process.

    Args:
        run: what to train.
        resume: go on from the last checkpoint, if there is one, until `run.steps` in all.

    Raises:
        LearningError: see `Run.check`; nothing is written then. Or the disk is full or cannot be written; the last
            complete checkpoint stays.
    """
    started, started_cpu = time.perf_counter(), time.process_time()
    run.check(resume)
    torch.set_num_threads(1)
    try:
        run.write_record()
        history = _learn(run, resume)
    except OSError as problem:
        raise LearningError(
            f"training had to stop: {problem}; the last complete checkpoint in {run.directory} stays, and --resume "
            "goes on from there"
        ) from problem
    return Trained(history, time.perf_counter() - started, time.process_time() - started_cpu)


def _learn(run: Run, resume: bool) -> list[dict[str, float]]:
    """The history of the run."""
    if run.algorithm in MOVER_LEARNERS:
        return train_mover(run, [] if run.demonstrations is None else _episodes(run))
    if run.algorithm in CLONERS:
        return _clone(run)
    if run.algorithm in DECISION_LEARNERS:
        return train_decisions(run)
    return _reinforce(run, resume)


def _reinforce(run: Run, resume: bool) -> list[dict[str, float]]:
    """Stable-Baselines3, with checkpoints."""
    is_resumed = resume and (run.directory / "model.zip").exists()
    evaluation_env = run.task.make()
    episodes = [] if run.demonstrations is None else _episodes(run)
    imitation = _imitation(run, episodes, is_resumed) if episodes else None
    has_clone = imitation is not None or (run.algorithm in SKILL_ALGORITHMS and run.episodes is not None)
    env = training_env(run.algorithm, run.task.make(), imitation)
    if is_resumed:
        model = load_model(run.algorithm, run.directory, env, with_buffer=True)
        model.tensorboard_log = str(run.directory)
    else:
        model = make_model(run.algorithm, env, run.seed, run.directory, has_clone)
        if isinstance(env, CorrectedActions):
            model.replay_buffer.keep(env, episodes)
        elif has_clone:
            clone_skills(run, model)

    def evaluate(model: Any) -> dict[str, float]:
        """Success at a checkpoint; weights that improve a clone are kept if no earlier ones did as well."""
        act = model_agent(run.algorithm, model, evaluation_env, imitation)
        found = {"success": _success(run, evaluation_env, act)}
        if has_clone:
            found["validation"] = _success(run, evaluation_env, act, VALIDATION_SEEDS)
            consider(acting_part(model), found["validation"], run.directory)
        return found

    if has_clone and not is_resumed:
        forget_chosen(run.directory)
        write_json(run.directory / HISTORY_FILE, [{"steps": 0, **evaluate(model)}])
    averaged = AveragedActor() if run.algorithm in GOAL_ALGORITHMS else None
    in_place = nullcontext if averaged is None else averaged.in_place
    checkpoints = Checkpoints(run.directory, run.checkpoint_every, evaluate, in_place)
    callbacks: list[BaseCallback] = [] if imitation is None else [CriticsFirst(CRITICS_ALONE)]
    callbacks += [checkpoints] if averaged is None else [averaged, checkpoints]
    left = run.steps - model.num_timesteps
    if left > 0:
        model.learn(left, callback=CallbackList(callbacks), reset_num_timesteps=False, tb_log_name="tensorboard")
        with in_place():
            save_model(model, run.directory)
    env.close()
    evaluation_env.close()
    return checkpoints.history


def _imitation(run: Run, episodes: Sequence[Episode], is_resumed: bool) -> Policy:
    """The clone of the demonstrations that is corrected."""
    if is_resumed:
        return Policy.load(run.directory / POLICY_FILE)
    imitation = clone(examples_of(episodes), CloneConfig(steps=run.imitation_steps, seed=run.seed))
    imitation.save(run.directory / POLICY_FILE)
    return imitation


def _clone(run: Run) -> list[dict[str, float]]:
    """Behaviour cloning or DAgger; a resumed run starts again from the beginning, since it is short."""
    assert run.demonstrations is not None
    env = run.task.make()
    examples = examples_of(_episodes(run))
    history: list[dict[str, float]] = []
    config = CloneConfig(steps=run.steps, seed=run.seed)
    with SummaryWriter(str(run.directory / "tensorboard")) as writer:

        def report_loss(step: int, loss: float) -> None:
            """Log the loss of a gradient step."""
            writer.add_scalar("train/loss", loss, step)

        def report_round(index: int, policy: Policy, examples: Examples) -> None:
            """Save and evaluate the policy of a round."""
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


def _success(run: Run, env: gym.Env, act: Callable[[Any], Any], first: int = HELD_OUT) -> float:
    """Success on the held-out scenes, or on those from another seed on."""
    return success_rate(env, act, held_out_seeds(run.evaluation_episodes, first), run.evaluation_steps)


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
