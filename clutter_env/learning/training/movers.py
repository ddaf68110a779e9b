"""Trains a mover from demonstrations, and evaluates it with the planner's decisions."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
from torch.utils.tensorboard import SummaryWriter

from clutter_env.learning.comparison.evaluation import DrawnScene, held_out_seeds, play_scene
from clutter_env.learning.contacts.hierarchical import HierarchicalPolicy
from clutter_env.learning.contacts.planned_decider import PlannedDecider
from clutter_env.learning.contacts.protocols import Mover
from clutter_env.learning.demonstrations.dataset import Dataset
from clutter_env.learning.demonstrations.episode import Episode
from clutter_env.learning.demonstrations.experts import PLANNERS
from clutter_env.learning.errors import DatasetError
from clutter_env.learning.keyframes.motions import motions_of
from clutter_env.learning.keyframes.network import save_arrays
from clutter_env.learning.policies.movers import fit_mover
from clutter_env.learning.policies.rl import HISTORY_FILE
from clutter_env.learning.policies.runs import MOVER_FILE
from clutter_env.learning.task import Task
from clutter_env.learning.training.run import Run
from clutter_env.reporting.json_file import write_json

__all__ = ["clean_successes", "decider_of", "task_of", "train_mover"]


def train_mover(run: Run, episodes: Sequence[Episode]) -> list[dict[str, float]]:
    """Train in this process; a resumed run starts again from the beginning, since it is short.

    The scenes on which it is evaluated are drawn as those of the demonstrations were.
    """
    assert run.demonstrations is not None
    dataset = Dataset(run.demonstrations)
    decider, env = decider_of(dataset), task_of(dataset).make()
    robot: Any = env.get_wrapper_attr("robot")
    started = time.process_time()
    with SummaryWriter(str(run.directory / "tensorboard")) as writer:

        def report(step: int, loss: float) -> None:
            """Log the loss of a gradient step."""
            writer.add_scalar("train/loss", loss, step)

        fitted = fit_mover(run.algorithm, robot, list(motions_of(episodes)), run.steps, run.seed, report)
    fit_s = time.process_time() - started
    save_arrays(run.directory / MOVER_FILE, fitted.network)
    successes = clean_successes(env, decider, fitted.mover, held_out_seeds(run.evaluation_episodes))
    env.close()
    success = sum(successes) / len(successes)
    history = [{"demonstrations": float(len(episodes)), "fit_s": fit_s, "success": success}]
    write_json(run.directory / HISTORY_FILE, history)
    return history


def task_of(dataset: Dataset) -> Task:
    """The environment in which a dataset was collected."""
    task = dataset.identity["task"]
    return Task(task["env_id"], task["keywords"])


def decider_of(dataset: Dataset) -> PlannedDecider:
    """Decisions of the planner whose motions a dataset shows.

    Raises:
        DatasetError: its expert is no planner.
    """
    expert = str(dataset.identity["expert"])
    if expert not in PLANNERS:
        raise DatasetError(
            f"{dataset.directory} shows the expert {expert!r}; movers learn from planners: {', '.join(PLANNERS)}"
        )
    choice = PLANNERS[expert]
    return PlannedDecider(choice.grasps, choice.canonical, choice.strategy)


def clean_successes(env: gym.Env[Any, Any], decider: PlannedDecider, mover: Mover, seeds: Iterable[int]) -> list[bool]:
    """Whether each scene ends in clean success."""
    policy = HierarchicalPolicy(decider, mover)
    return [play_scene(DrawnScene(seed), env, policy).clean for seed in seeds]
