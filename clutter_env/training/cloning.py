"""Behaviour cloning, regression of the expert's actions on the observations, and DAgger, cloning in rounds.

In a round of DAgger the learner acts for a random number of steps from the start of an episode, then the expert acts
until the end; its part becomes examples only if the episode succeeds. This is roll-in with the learner and roll-out
with the expert, as in Ross & Bagnell 2014 (Reinforcement and imitation learning via interactive no-regret learning).
The original DAgger (Ross, Gordon & Bagnell 2011) asks the expert for its action at every step of the learner. That does
not suit an expert that plans, and it made the clones of scripts worse: the many examples of states in which the learner
is stuck outweigh those that lead to the goal.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray

from clutter_env.data.dataset import Dataset
from clutter_env.data.episode import Episode
from clutter_env.errors import DatasetError, LearningError
from clutter_env.evaluation.score import success_rate
from clutter_env.policies.cloning import POLICY_FILE, ClonedPolicy, feature_vector
from clutter_env.policies.experts import Expert, find_expert, make_expert
from clutter_env.policies.protocol import begin_episode
from clutter_env.provenance import provenance
from clutter_env.seeds import held_out_seeds
from clutter_env.task import Task
from clutter_env.training.descent import ExampleArrays, Report, RunLog, descend
from clutter_env.training.run import Run
from clutter_env.training.settings import BC, DAgger

_BATCH = 512
"""Examples in a gradient step."""
MAX_LEARNER_STEPS = 150
"""The learner acts for at most so many steps, and for at most half of an episode, which leaves time for the expert."""


@dataclass(frozen=True, eq=False)
class Examples(ExampleArrays):
    """Pairs of features (k, f) and actions (k, a)."""

    features: NDArray[np.float32]
    actions: NDArray[np.float32]


def train_clone(run: Run) -> list[dict[str, float]]:
    """Train; the history of the rounds. A resumed run starts again from the beginning, since it is short."""
    settings = run.settings
    assert isinstance(settings, BC)
    dataset, episodes = read_demonstrations(run.task, settings)
    env = run.task.make()
    examples = examples_of(episodes)
    seeds = held_out_seeds(settings.evaluation_episodes)
    with RunLog(run) as log:

        def finish_round(policy: ClonedPolicy, examples: Examples) -> None:
            policy.save(run.directory / POLICY_FILE, provenance(env))
            success = success_rate(env, policy, seeds, settings.evaluation_steps)
            log.add(round=len(log.history), examples=len(examples.actions), success=success)

        policy = clone(examples, settings.steps, run.seed, log.loss)
        finish_round(policy, examples)
        if isinstance(settings, DAgger):
            expert = make_expert(find_expert(run.task.env_id, settings.expert or str(dataset.identity["expert"])))
            rng = np.random.default_rng(run.seed)
            (own,) = settings.scene_seeds(run.seed)
            for start in range(0, len(own), settings.round_episodes):
                for seed in own[start : start + settings.round_episodes]:
                    examples = Examples.joined((examples, take_over(env, expert, policy, seed, rng)))
                policy = clone(examples, settings.steps, run.seed)
                finish_round(policy, examples)
    env.close()
    return log.history


def read_demonstrations(task: Task, settings: BC) -> tuple[Dataset, list[Episode]]:
    """The dataset that a run learns from, and those of its episodes that it uses.

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
    return dataset, list(dataset)[: settings.demo_episodes]


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


def take_over(env: gym.Env, expert: Expert, policy: ClonedPolicy, seed: int, rng: np.random.Generator) -> Examples:
    """The examples of the expert's part of one episode; none if the episode does not succeed."""
    observation, info = env.reset(seed=seed)
    limit = env.spec.max_episode_steps if env.spec is not None else None
    most = MAX_LEARNER_STEPS if limit is None else min(MAX_LEARNER_STEPS, max(limit // 2, 1))
    is_over = False
    for _ in range(int(rng.integers(most))):
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        is_over = terminated or truncated
        if is_over:
            break
    features, actions = [], []
    if not is_over:
        begin_episode(expert, info, env)
    while not (is_over or expert.done):
        features.append(feature_vector(observation))
        actions.append(np.asarray(expert.act(observation), np.float32))
        observation, _, terminated, truncated, info = env.step(actions[-1])
        is_over = terminated or truncated
    kept = len(actions) if info["is_success"] else 0
    size = (feature_vector(observation).shape[-1], *(env.action_space.shape or ()))
    return Examples(
        np.array(features[:kept], np.float32).reshape(-1, size[0]),
        np.array(actions[:kept], np.float32).reshape(-1, size[1]),
    )
