"""DAgger: the learner acts, the expert takes over, and the learner is taught what it did.

The learner acts for a random while from the start of an episode, the expert from there to the end, and only if that
succeeds is it learnt from: rolling in with the learner and out with the expert, as in Ross & Bagnell 2014. To ask the
expert at every step of the learner's what it would do (Ross, Gordon & Bagnell 2011) is no use where it plans, and made
the clones of scripts worse: what it says where the learner is stuck drowns what leads to the goal.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import gymnasium as gym
import numpy as np

from clutter_env.learning.demonstrations.experts import Expert
from clutter_env.learning.policies.features import feature_vector
from clutter_env.learning.policies.policy import Policy
from clutter_env.learning.training.bc import CloneConfig, Examples, clone

__all__ = ["DaggerConfig", "dagger", "take_over"]


@dataclass(frozen=True)
class DaggerConfig:
    """Rounds of acting and learning, episodes in each, and how to fit after each."""

    rounds: int = 5
    episodes: int = 10
    fit: CloneConfig = field(default_factory=CloneConfig)


LONGEST_LEAD = 150
"""Steps for which the learner acts at most; at most half of an episode, so that the expert has time for its part."""


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
        env: where both act.
        expert: for that environment.
        examples: the expert's own episodes, to begin with.
        seeds: of the learner's episodes, `rounds * episodes` of them.
        config: how long.
        report: called after every fit with the round's number (0: before the first), the policy and all examples.
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
    """Corrections from one episode; none where the expert does not succeed."""
    observation, info = env.reset(seed=seed)
    is_over = False
    for _ in range(int(rng.integers(_longest_lead(env)))):
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


def _longest_lead(env: gym.Env) -> int:
    limit = env.spec.max_episode_steps if env.spec is not None else None
    return LONGEST_LEAD if limit is None else min(LONGEST_LEAD, max(limit // 2, 1))
