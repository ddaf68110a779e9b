"""DAgger: the learner acts, the expert says what it would have done, and the learner is taught that too.

An expert that is a function of the present state is asked at every step (Ross, Gordon & Bagnell 2011). One that plans
takes over after the learner has acted for a while, and what it does from there on is the correction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from learning.bc import CloneConfig, Examples, clone
from learning.experts import Expert
from learning.features import feature_vector
from learning.policy import Policy

__all__ = ["DaggerConfig", "Teacher", "ask_every_step", "dagger", "take_over"]


@dataclass(frozen=True)
class DaggerConfig:
    """Rounds of acting and learning, episodes in each, and how to fit after each."""

    rounds: int = 5
    episodes: int = 10
    fit: CloneConfig = field(default_factory=CloneConfig)


LONGEST = 300
"""Steps for which the learner acts at most: thrice what an expert needs; one that is stuck teaches nothing new."""

Teacher = Callable[[gym.Env, Expert, Policy, int, np.random.Generator], Examples]
"""Corrections from one episode: environment, expert, learner, seed, random generator."""


def dagger(
    env: gym.Env,
    expert: Expert,
    teacher: Teacher,
    examples: Examples,
    seeds: Sequence[int],
    config: DaggerConfig,
    report: Callable[[int, Policy, Examples], None] = lambda *_: None,
) -> Policy:
    """The policy after the last round.

    Args:
        env: where both act.
        expert: for that environment.
        teacher: how the expert corrects: `ask_every_step` or `take_over`.
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
            examples = examples + teacher(env, expert, policy, seed, rng)
        policy = clone(examples, config.fit)
        report(index + 1, policy, examples)
    return policy


def ask_every_step(env: gym.Env, expert: Expert, policy: Policy, seed: int, rng: np.random.Generator) -> Examples:  # noqa: ARG001
    """The learner acts, to the end if it comes to one in time; the expert is asked at every step."""
    observation, _ = env.reset(seed=seed)
    expert.reset()
    features: list[NDArray[np.float32]] = []
    actions: list[NDArray[np.float32]] = []
    is_over = False
    while not is_over and len(actions) < LONGEST:
        features.append(feature_vector(observation))
        actions.append(np.asarray(expert.act(), np.float32))
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        is_over = terminated or truncated
    return Examples(np.stack(features), np.stack(actions))


def take_over(env: gym.Env, expert: Expert, policy: Policy, seed: int, rng: np.random.Generator) -> Examples:
    """The learner acts for a random while; the expert plans from what came of it and acts to the end.

    Nothing is learnt where the expert finds no plan.
    """
    observation, info = env.reset(seed=seed)
    is_over = False
    for _ in range(int(rng.integers(LONGEST))):
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
