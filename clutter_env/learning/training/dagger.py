"""DAgger: the learner acts, the expert takes over, and the learner imitates the expert's part.

The learner acts for a random number of steps from the start of an episode, then the expert acts until the end; its part
becomes examples only if the episode succeeds. This is roll-in with the learner and roll-out with the expert, as in Ross
& Bagnell 2014 (Reinforcement and imitation learning via interactive no-regret learning). The original DAgger (Ross,
Gordon & Bagnell 2011) asks the expert for its action at every step of the learner. That does not suit an expert that
plans, and it made the clones of scripts worse: the many examples of states in which the learner is stuck outweigh those
that lead to the goal.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import gymnasium as gym
import numpy as np

from clutter_env.policies.experts import Expert
from clutter_env.learning.policies.features import feature_vector
from clutter_env.learning.policies.policy import Policy
from clutter_env.learning.training.bc import CloneConfig, Examples, clone

__all__ = ["DaggerConfig", "dagger", "take_over"]


@dataclass(frozen=True)
class DaggerConfig:
    """Number of rounds, episodes of the learner in each, and settings of the regression after each."""

    rounds: int = 5
    episodes: int = 10
    fit: CloneConfig = field(default_factory=CloneConfig)


MAX_LEARNER_STEPS = 150
"""The learner acts for at most so many steps, and for at most half of an episode, which leaves time for the expert."""


def dagger(
    env: gym.Env,
    expert: Expert,
    examples: Examples,
    seeds: Sequence[int],
    config: DaggerConfig,
    report: Callable[[int, Policy, Examples], None] = lambda *_: None,
) -> Policy:
    """The policy after the last round.

    Args:
        env: in which both act.
        expert: for that environment.
        examples: of the demonstrations.
        seeds: of the learner's episodes, `rounds * episodes` of them.
        config: settings.
        report: called after every fit with the round's number (0 before the first round), policy and all examples.
    """
    rng = np.random.default_rng(config.fit.seed)
    policy = clone(examples, config.fit)
    report(0, policy, examples)
    for index in range(config.rounds):
        for seed in seeds[index * config.episodes : (index + 1) * config.episodes]:
            examples = examples + take_over(env, expert, policy, seed, rng)
        policy = clone(examples, config.fit)
        report(index + 1, policy, examples)
    return policy


def take_over(env: gym.Env, expert: Expert, policy: Policy, seed: int, rng: np.random.Generator) -> Examples:
    """The examples of the expert's part of one episode; none if the episode does not succeed."""
    observation, info = env.reset(seed=seed)
    is_over = False
    for _ in range(int(rng.integers(_max_learner_steps(env)))):
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        is_over = terminated or truncated
        if is_over:
            break
    features, actions = [], []
    if not is_over:
        expert.reset()
    while not (is_over or expert.done):
        features.append(feature_vector(observation))
        actions.append(np.asarray(expert.act(), np.float32))
        observation, _, terminated, truncated, info = env.step(actions[-1])
        is_over = terminated or truncated
    kept = len(actions) if info["is_success"] else 0
    size = (feature_vector(observation).shape[-1], *(env.action_space.shape or ()))
    return Examples(
        np.array(features[:kept], np.float32).reshape(-1, size[0]),
        np.array(actions[:kept], np.float32).reshape(-1, size[1]),
    )


def _max_learner_steps(env: gym.Env) -> int:
    limit = env.spec.max_episode_steps if env.spec is not None else None
    return MAX_LEARNER_STEPS if limit is None else min(MAX_LEARNER_STEPS, max(limit // 2, 1))
