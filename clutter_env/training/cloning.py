"""Behaviour cloning: regression of the expert's actions on the observations."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from clutter_env.data.dataset import Dataset
from clutter_env.data.episode import Episode
from clutter_env.errors import DatasetError, LearningError
from clutter_env.evaluation.score import success_rate
from clutter_env.policies.cloning import POLICY_FILE, ClonedPolicy, feature_vector
from clutter_env.provenance import provenance
from clutter_env.seeds import held_out_seeds
from clutter_env.task import Task
from clutter_env.training.descent import ExampleArrays, Report, RunLog, descend
from clutter_env.training.run import Run
from clutter_env.training.settings import BC

_BATCH = 512
"""Examples in a gradient step."""


@dataclass(frozen=True, eq=False)
class Examples(ExampleArrays):
    """Pairs of features (k, f) and actions (k, a)."""

    features: NDArray[np.float32]
    actions: NDArray[np.float32]


def train_clone(run: Run) -> list[dict[str, float]]:
    """Train; the history. A resumed run starts again from the beginning, since it is short."""
    settings = run.settings
    assert isinstance(settings, BC)
    env, examples = run.task.make(), examples_of(read_demonstrations(run.task, settings))
    with RunLog(run) as log:
        policy = clone(examples, settings.steps, run.seed, log.loss)
        policy.save(run.directory / POLICY_FILE, provenance(env))
        success = success_rate(env, policy, held_out_seeds(settings.evaluation_episodes), settings.evaluation_steps)
        log.add(examples=len(examples.actions), success=success)
    env.close()
    return log.history


def read_demonstrations(task: Task, settings: BC) -> list[Episode]:
    """The episodes that a run learns from.

    Raises:
        DatasetError: there is no complete dataset.
        LearningError: it was collected in another environment.
    """
    dataset = Dataset(settings.demos)
    there, here = dataset.task, task
    if there.env_id != here.env_id:
        raise LearningError(f"{settings.demos} holds demonstrations of {there.env_id}, not of {here.env_id}")
    modes = [one.keywords.get("control_mode") for one in (there, here)]
    if modes[0] != modes[1]:
        raise LearningError(
            f"{settings.demos} was collected with control_mode={modes[0]!r}, this is {modes[1]!r} (None: the default)"
        )
    dataset.warn_if_outdated()
    return list(dataset)[: settings.demo_episodes]


def examples_of(episodes: Iterable[Episode]) -> Examples:
    """All steps of the episodes.

    Raises:
        DatasetError: there are no episodes.
    """
    parts = [Examples(feature_vector(episode.observations)[:-1], episode.actions) for episode in episodes]
    if not parts:
        raise DatasetError("there are no episodes to learn from")
    return Examples.joined(parts)


def clone(examples: Examples, steps: int = 10_000, seed: int = 0, report: Report = lambda *_: None) -> ClonedPolicy:
    """Fit a new policy to examples; the report is called with the step and the loss every 500 gradient steps."""
    torch.manual_seed(seed)
    features, actions = torch.from_numpy(examples.features), torch.from_numpy(examples.actions)
    policy = ClonedPolicy(features.shape[1], actions.shape[1])

    def loss(_: int) -> torch.Tensor:
        chosen = torch.randint(len(features), (_BATCH,))
        return torch.nn.functional.smooth_l1_loss(policy(features[chosen]), actions[chosen], beta=0.1)

    descend(torch.optim.Adam(policy.parameters(), lr=1e-3), steps, loss, report)
    return policy
