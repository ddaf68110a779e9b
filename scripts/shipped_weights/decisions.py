"""Trains a high-level policy: examples from random scenes, then from the states that the learner comes into."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from torch.nn.functional import binary_cross_entropy_with_logits

from clutter_env.errors import LearningError
from clutter_env.policies.high_level.candidates import CandidateRule
from clutter_env.policies.high_level.network import CandidateBatch, CandidateNetwork
from clutter_env.policies.high_level.policy import LearnedHighLevelPolicy
from clutter_env.seeds import held_out_seeds, training_seeds
from scripts.shipped_weights.decision_examples import (
    CandidateExamples,
    examples_of_scene,
    initial_scenes,
    roll_out,
    visited_examples,
)
from scripts.shipped_weights.descent import Report, descend

FIRST_SEED, SEEDS_OF_A_RUN, RUNS = 10_000, 20_000, 20
"""First seed of the scenes for decisions; seeds from the first one of a run to that of the next; runs that have scenes
of their own."""
_LEARNING_RATE = 2e-3
_BATCH = 256
"""Reached candidates in a gradient step."""
_REACH_SHARE = 8
"""Candidates in a step for each one of those that are reached: most of them are not, and cost little."""
_ROUND_SHARE = 0.5
"""Gradient steps of a round of DAgger, as a share of the first fit's."""
_ROUND_RATE = 0.3
"""Its learning rate, as a share of the first fit's."""


@dataclass(frozen=True)
class DecisionBudget:
    """How much is collected and learned for decisions.

    Attributes:
        scenes: from which examples are collected.
        steps: gradient steps of the first fit.
        rounds: after the first fit, which learn from the states that the learner comes into (DAgger).
        round_episodes: scenes of each of these rounds.
        evaluation: held-out scenes in which the policy of each round decides.
    """

    scenes: int
    steps: int = 3000
    rounds: int = 0
    round_episodes: int = 60
    evaluation: int = 20


def train_decisions(
    env: gym.Env[Any, Any],
    rule: CandidateRule,
    seed: int,
    budget: DecisionBudget,
    examples_file: Path,
    log: Callable[[str], object] = lambda _: None,
) -> CandidateNetwork:
    """The network of a high-level policy.

    It is fitted to examples of `scenes` scenes; in each of `rounds` the learner then decides in `round_episodes` new
    scenes, without physics, and is fitted to all examples (DAgger).

    Args:
        env: in which scenes are drawn.
        rule: the candidates.
        seed: of the network; the seeds of the scenes follow from it.
        budget: how much.
        examples_file: keeps the examples of the first fit; one that is there is read.
        log: is told how well the policy of each round does on held-out scenes, without physics, and on the examples.
    """
    first = FIRST_SEED + seed % RUNS * SEEDS_OF_A_RUN
    seeds = training_seeds(first, budget.scenes)
    of_rounds = training_seeds(first + SEEDS_OF_A_RUN // 2, budget.rounds * budget.round_episodes)

    def collect() -> CandidateExamples:
        starts = zip(seeds, initial_scenes(env, seeds), strict=True)
        parts = [examples_of_scene(scene, rule, np.random.default_rng(seed)) for seed, (scene, _) in starts]
        return CandidateExamples.joined(parts)

    def tell(number: int, network: CandidateNetwork) -> None:
        policy = LearnedHighLevelPolicy(network, rule)
        outcomes = [roll_out(policy, *start) for start in initial_scenes(env, held_out_seeds(budget.evaluation))]
        cleared = [outcome.clearances for outcome in outcomes if not outcome.failure]
        rates = {"success": len(cleared) / len(outcomes), "clearances": float(np.mean(cleared or math.nan))}
        said = ", ".join(f"{name} {value:.3g}" for name, value in {**rates, **accuracy(network, examples)}.items())
        log(f"decisions, round {number}, {len(examples.scene)} examples: {said}")

    examples = CandidateExamples.kept(examples_file, collect)
    network = fit_high_level(examples, budget.steps, seed)
    tell(0, network)
    for number in range(1, budget.rounds + 1):
        of_round = of_rounds[(number - 1) * budget.round_episodes :][: budget.round_episodes]
        policy = LearnedHighLevelPolicy(network, rule)
        rollouts = [roll_out(policy, *scene) for scene in initial_scenes(env, of_round)]
        visited = visited_examples(rollouts, rule, np.random.default_rng(of_round[0]))
        examples = CandidateExamples.joined((examples, *visited))
        network = fit_high_level(
            examples, int(_ROUND_SHARE * budget.steps), seed, network, _ROUND_RATE * _LEARNING_RATE
        )
        tell(number, network)
    return network


def fit_high_level(
    examples: CandidateExamples,
    steps: int,
    seed: int = 0,
    network: CandidateNetwork | None = None,
    learning_rate: float = _LEARNING_RATE,
    report: Report = lambda *_: None,
) -> CandidateNetwork:
    """Fit a network; half of the batches are mirrored left to right, which changes no label.

    Args:
        examples: to learn from.
        steps: gradient steps.
        seed: random seed.
        network: is changed; a new one if not given.
        learning_rate: the first one; it falls to zero along a cosine.
        report: called with the step and the loss every 500 steps.

    Raises:
        LearningError: no candidate of the examples is reached.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    reached = np.flatnonzero(examples.is_reached)
    if not len(reached):
        raise LearningError("no candidate of the examples is reached: there is nothing to learn from")
    fitted = CandidateNetwork() if network is None else network

    def loss(step: int) -> torch.Tensor:
        is_mirrored = bool(step % 2)
        of_blockers = _blockers_loss(fitted, examples, rng.choice(reached, _BATCH), is_mirrored)
        rows = rng.integers(len(examples.scene), size=_REACH_SHARE * _BATCH)
        logits = fitted.reach_logits(batch_of(examples, rows, is_mirrored))
        is_reached = torch.from_numpy(examples.is_reached[rows]).float()
        return of_blockers + binary_cross_entropy_with_logits(logits, is_reached)

    optimiser = torch.optim.AdamW(fitted.parameters(), lr=learning_rate, weight_decay=1e-4)
    descend(optimiser, steps, loss, report)
    return fitted


def accuracy(network: CandidateNetwork, examples: CandidateExamples, most: int = 20_000) -> dict[str, float]:
    """Shares of right answers on examples, at most so many of each kind.

    Returns:
        `reach`: among all candidates; `blocks`: among the pairs of a reached candidate and an object; `free`: among
        reached candidates, whether they are free; `precision`: of those called free; `recall`: of the free ones; NaN
        where there are none.
    """
    rng = np.random.default_rng(0)
    every = rng.permutation(len(examples.scene))[:most]
    reached = rng.permutation(np.flatnonzero(examples.is_reached))[:most]
    with torch.no_grad():
        reach = network.reach_logits(batch_of(examples, every)).numpy() > 0
        blocks = network(batch_of(examples, reached)).numpy() > 0
    truth, is_present = examples.blockers[reached], batch_of(examples, reached).is_present.numpy()
    is_free, is_called_free = ~truth.any(axis=1), ~blocks.any(axis=1)
    answers = {
        "reach": reach == examples.is_reached[every],
        "blocks": (blocks == truth)[is_present],
        "free": is_free == is_called_free,
        "precision": is_free[is_called_free],
        "recall": is_called_free[is_free],
    }
    return {name: float(right.mean()) if len(right) else math.nan for name, right in answers.items()}


def batch_of(examples: CandidateExamples, rows: np.ndarray, is_mirrored: bool = False) -> CandidateBatch:
    """Some candidates for the network; mirrored, y and yaws have the other sign."""
    others = torch.from_numpy(examples.objects[examples.scene[rows]])
    index = torch.arange(others.shape[1])
    is_present = (others[..., 3] > 0) & (index != torch.from_numpy(examples.own_index[rows].astype(np.int64))[:, None])
    own, tcp, base = (torch.from_numpy(column[rows]) for column in (examples.own, examples.tcp, examples.base))
    if is_mirrored:
        side = torch.tensor((1.0, -1.0, 1.0, 1.0, 1.0))
        own, others = own * side, others * side
        tcp, base = tcp * torch.tensor((1.0, -1.0, 1.0, -1.0, 1.0)), base * torch.tensor((1.0, -1.0, -1.0))
    return CandidateBatch(own, tcp, base, others, is_present)


def _blockers_loss(
    network: CandidateNetwork, examples: CandidateExamples, rows: np.ndarray, is_mirrored: bool
) -> torch.Tensor:
    """Of what is in the way of reached candidates: object by object, and whether it is anything at all."""
    batch = batch_of(examples, rows, is_mirrored)
    truth = torch.from_numpy(examples.blockers[rows])
    blocks = network(batch)
    pairs = binary_cross_entropy_with_logits(blocks[batch.is_present], truth[batch.is_present].float())
    log_free = torch.nn.functional.logsigmoid(-blocks).sum(1).clamp(max=-1e-6)
    is_free = ~truth.any(1)
    free = -torch.where(is_free, log_free, torch.log1p(-log_free.exp())).mean()
    return 10 * pairs + free
