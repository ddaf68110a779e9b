"""Trains a mover from demonstrations, and evaluates it with the planner's decisions."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

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
from clutter_env.learning.keyframes.motions import Motion, motions_of
from clutter_env.learning.keyframes.network import save_arrays
from clutter_env.learning.keyframes.planned import planned_motions
from clutter_env.learning.policies.movers import fit_mover
from clutter_env.learning.policies.rl import HISTORY_FILE
from clutter_env.learning.policies.runs import MOVER_FILE
from clutter_env.learning.task import Task
from clutter_env.learning.training.run import Run
from clutter_env.reporting.files import write_json

__all__ = ["clean_successes", "decider_of", "task_of", "train_mover"]


PLANS = 600
"""Scenes that are planned where there are no demonstrations, if the run does not say."""
_FIRST_SEED, _SEEDS_OF_A_RUN = 100_000, 20_000
"""Scenes of these plans: those of a training seed, all below the held-out ones."""


class _Shown(NamedTuple):
    """What a mover learns from and is evaluated on."""

    motions: list[Motion]
    demonstrations: int
    decider: PlannedDecider
    task: Task


def train_mover(run: Run, episodes: Sequence[Episode]) -> list[dict[str, float]]:
    """Train in this process; a resumed run starts again from the beginning, since it is short.

    The scenes on which it is evaluated are drawn as those of the demonstrations were. Without demonstrations the
    motions are those of canonical plans, of which nothing is simulated.
    """
    started = time.process_time()
    shown = _of_plans(run) if run.demonstrations is None else _of_dataset(run.demonstrations, episodes)
    plan_s, env = time.process_time() - started, shown.task.make()
    robot: Any = env.get_wrapper_attr("robot")
    with SummaryWriter(str(run.directory / "tensorboard")) as writer:

        def report(step: int, loss: float) -> None:
            """Log the loss of a gradient step."""
            writer.add_scalar("train/loss", loss, step)

        fitted = fit_mover(run.algorithm, robot, shown.motions, run.steps, run.seed, report)
    fit_s = time.process_time() - started - plan_s
    save_arrays(run.directory / MOVER_FILE, fitted.network)
    successes = clean_successes(env, shown.decider, fitted.mover, held_out_seeds(run.evaluation_episodes))
    env.close()
    success = sum(successes) / len(successes)
    counts = {"demonstrations": float(shown.demonstrations), "motions": float(len(shown.motions))}
    history = [{**counts, "plan_s": plan_s, "fit_s": fit_s, "success": success}]
    write_json(run.directory / HISTORY_FILE, history)
    return history


def _of_dataset(directory: Path, episodes: Sequence[Episode]) -> _Shown:
    """The motions of demonstrations."""
    dataset = Dataset(directory)
    return _Shown(list(motions_of(episodes)), len(episodes), decider_of(dataset), task_of(dataset))


def _of_plans(run: Run) -> _Shown:
    """The motions of canonical plans."""
    count, first = run.episodes or PLANS, _FIRST_SEED + run.seed * _SEEDS_OF_A_RUN
    env = run.task.make()
    motions = list(planned_motions(env, run.grasps, range(first, first + count)))
    env.close()
    return _Shown(motions, count, PlannedDecider(run.grasps), run.task)


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
