"""Trains a motion policy from demonstrations or plans, and evaluates it with the planner's choice of actions."""

from __future__ import annotations

import time
from typing import Any

import torch
from torch.utils.tensorboard import SummaryWriter

from clutter_env.data.dataset import Dataset
from clutter_env.errors import DatasetError
from clutter_env.evaluation.score import held_out_seeds, success_rate
from clutter_env.policies.experts import PLANNERS
from clutter_env.policies.motion.keyframe_policy import KeyframePolicy
from clutter_env.policies.planned import PlannedHighLevelPolicy
from clutter_env.policies.runs import MOTIONS_FILE
from clutter_env.policies.two_level import TwoLevelPolicy
from clutter_env.policies.weights import WeightsInfo, save_weights
from clutter_env.reporting.files import write_json
from clutter_env.training.motion_demonstrations import motions_of, planned_motions
from clutter_env.training.motion_fit import fit_motions
from clutter_env.training.reinforcement import HISTORY_FILE
from clutter_env.training.run import Run
from clutter_env.training.settings import Keyframes

_FIRST_SEED, _SEEDS_OF_A_RUN = 100_000, 20_000
"""Scenes of plans: those of a training seed, all below the held-out ones."""


def train_motions(run: Run) -> list[dict[str, float]]:
    """Train in this process; a resumed run starts again from the beginning, since it is short.

    The scenes on which it is evaluated are drawn as those of the demonstrations were. Without demonstrations the
    motions are those of canonical plans, of which nothing is simulated.
    """
    torch.set_num_threads(1)
    settings = run.settings
    assert isinstance(settings, Keyframes)
    started = time.process_time()
    if settings.demos is None:
        task, high_level, count = run.task, PlannedHighLevelPolicy(settings.grasps), settings.plans
        first = _FIRST_SEED + run.seed * _SEEDS_OF_A_RUN
        env: Any = task.make()
        motions = list(planned_motions(env, settings.grasps, range(first, first + count)))
    else:
        dataset = Dataset(settings.demos)
        dataset.warn_if_outdated()
        task, high_level = dataset.task, high_level_of(dataset)
        env = task.make()
        episodes = list(dataset)[: settings.demo_episodes]
        motions, count = list(motions_of(episodes)), len(episodes)
    plan_s = time.process_time() - started
    with SummaryWriter(str(run.directory / "tensorboard")) as writer:
        robot = env.get_wrapper_attr("robot")
        report = lambda step, loss: writer.add_scalar("train/loss", loss, step)  # noqa: E731
        network = fit_motions(robot, motions, settings.steps, run.seed, report)
    fit_s = time.process_time() - started - plan_s
    info = WeightsInfo.of_env("motions", env, high_level.grasps)
    save_weights(run.directory / MOTIONS_FILE, network, info)
    policy = TwoLevelPolicy(high_level, KeyframePolicy(network, info))
    success = success_rate(env, policy, held_out_seeds(settings.evaluation_episodes))
    env.close()
    counts = {"demonstrations": float(count), "motions": float(len(motions))}
    history = [{**counts, "plan_s": plan_s, "fit_s": fit_s, "success": success}]
    write_json(run.directory / HISTORY_FILE, history)
    return history


def high_level_of(dataset: Dataset) -> PlannedHighLevelPolicy:
    """The planner whose motions a dataset shows, as a high-level policy.

    Raises:
        DatasetError: its expert is no planner.
    """
    expert = str(dataset.identity["expert"])
    if expert not in PLANNERS:
        raise DatasetError(
            f"{dataset.directory} shows the expert {expert!r}; motions are learned from planners: {', '.join(PLANNERS)}"
        )
    choice = PLANNERS[expert]
    return PlannedHighLevelPolicy(choice.grasps, choice.canonical, choice.strategy)
