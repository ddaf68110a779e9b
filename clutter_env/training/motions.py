"""Trains a motion policy from demonstrations or plans, and evaluates it with the planner's choice of actions."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import torch
from torch.utils.tensorboard import SummaryWriter

from assets import RobotSpec
from clutter_env.data.dataset import Dataset
from clutter_env.errors import DatasetError
from clutter_env.evaluation.score import held_out_seeds, success_rate
from clutter_env.learning.contacts.hierarchical import HierarchicalPolicy
from clutter_env.learning.contacts.planned_decider import PlannedDecider
from clutter_env.learning.demonstrations.experts import PLANNERS
from clutter_env.learning.keyframes.boards.cutting import is_driven
from clutter_env.learning.keyframes.boards.shown_postures import shown_postures
from clutter_env.learning.keyframes.examples import examples_of
from clutter_env.learning.keyframes.fit import FitConfig, fit_keyframes
from clutter_env.learning.keyframes.ground import closed_ground
from clutter_env.learning.keyframes.motions import Motion, motions_of
from clutter_env.learning.keyframes.mover import KeyframeMover
from clutter_env.learning.keyframes.network import KeyframeNetwork, save_arrays
from clutter_env.learning.keyframes.planned import planned_motions
from clutter_env.learning.regression.descent import Report
from clutter_env.policies.runs import MOVER_FILE
from clutter_env.reporting.files import write_json
from clutter_env.training.reinforcement import HISTORY_FILE
from clutter_env.training.run import Run
from clutter_env.training.settings import Keyframes

_FIRST_SEED, _SEEDS_OF_A_RUN = 100_000, 20_000
"""Scenes of plans: those of a training seed, all below the held-out ones."""


def train_motions(run: Run, settings: Keyframes) -> list[dict[str, float]]:
    """Train in this process; a resumed run starts again from the beginning, since it is short.

    The scenes on which it is evaluated are drawn as those of the demonstrations were. Without demonstrations the
    motions are those of canonical plans, of which nothing is simulated.
    """
    torch.set_num_threads(1)
    started = time.process_time()
    if settings.demos is None:
        task, high_level, count = run.task, PlannedDecider(settings.grasps), settings.plans
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
        network = fit_motions(
            env.get_wrapper_attr("robot"),
            motions,
            FitConfig(steps=settings.steps, seed=run.seed),
            lambda step, loss: writer.add_scalar("train/loss", loss, step),
        )
    fit_s = time.process_time() - started - plan_s
    save_arrays(run.directory / MOVER_FILE, network)
    policy = HierarchicalPolicy(high_level, KeyframeMover(network))
    success = success_rate(env, policy, held_out_seeds(settings.evaluation_episodes))
    env.close()
    counts = {"demonstrations": float(count), "motions": float(len(motions))}
    history = [{**counts, "plan_s": plan_s, "fit_s": fit_s, "success": success}]
    write_json(run.directory / HISTORY_FILE, history)
    return history


def fit_motions(
    robot: RobotSpec, motions: Sequence[Motion], config: FitConfig, report: Report = lambda *_: None
) -> KeyframeNetwork:
    """A keyframe network fitted to motions, with the arm configurations and free ground that they show.

    Raises:
        DatasetError: there are no motions.
    """
    network = fit_keyframes(robot, examples_of(robot, motions), config, report)
    if network.is_under_board:
        network.offer_postures(shown_postures(robot, [motion for motion in motions if is_driven(motion)]))
    network.keep_out_of(closed_ground(motions))
    return network


def high_level_of(dataset: Dataset) -> PlannedDecider:
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
    return PlannedDecider(choice.grasps, choice.canonical, choice.strategy)
