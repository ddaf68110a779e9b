"""Fits the network of the high-level policy to examples."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch.nn.functional import binary_cross_entropy_with_logits

from clutter_env.errors import LearningError
from clutter_env.policies.high_level.network import CandidateBatch, CandidateNetwork
from clutter_env.training.descent import DescentConfig, Report, descend
from clutter_env.training.high_level_examples import CandidateExamples

_REACH_SHARE = 8
"""Candidates in a batch for each one of those that are reached: most of them are not, and cost little."""


@dataclass(frozen=True)
class HighLevelFitConfig(DescentConfig):
    """Settings; `batch` counts the reached candidates in each step."""

    steps: int = 6000
    learning_rate: float = 2e-3
    width: int = 96


def fit_high_level(
    examples: CandidateExamples,
    config: HighLevelFitConfig = HighLevelFitConfig(),
    network: CandidateNetwork | None = None,
    report: Report = lambda *_: None,
) -> CandidateNetwork:
    """Fit a network; half of the batches are mirrored left to right, which changes no label.

    Args:
        examples: to learn from.
        config: settings.
        network: is changed; a new one if not given.
        report: called with the step and the loss every 500 steps.

    Raises:
        LearningError: no candidate of the examples is reached.
    """
    torch.manual_seed(config.seed)
    rng = np.random.default_rng(config.seed)
    reached = np.flatnonzero(examples.is_reached)
    if not len(reached):
        raise LearningError("no candidate of the examples is reached: there is nothing to learn from")
    fitted = CandidateNetwork(config.width) if network is None else network

    def loss(step: int) -> torch.Tensor:
        is_mirrored = bool(step % 2)
        of_blockers = _loss(fitted, examples, rng.choice(reached, config.batch), is_mirrored)
        rows = rng.integers(len(examples), size=_REACH_SHARE * config.batch)
        return of_blockers + _reach_loss(fitted, examples, rows, is_mirrored)

    optimiser = torch.optim.AdamW(fitted.parameters(), lr=config.learning_rate, weight_decay=1e-4)
    descend(optimiser, config.steps, loss, report)
    return fitted


def accuracy(network: CandidateNetwork, examples: CandidateExamples, most: int = 20_000) -> dict[str, float]:
    """Shares of right answers on examples, at most so many of each kind.

    Returns:
        `reach`: among all candidates; `blocks`: among the pairs of a reached candidate and an object; `free`: among
        reached candidates, whether they are free; `precision`: of those called free; `recall`: of the free ones; NaN
        where there are none.
    """
    rng = np.random.default_rng(0)
    every = rng.permutation(len(examples))[:most]
    reached = rng.permutation(np.flatnonzero(examples.is_reached))[:most]
    with torch.no_grad():
        reach = network(batch_of(examples, every)).reach.numpy() > 0
        blocks = network(batch_of(examples, reached)).blocks.numpy() > 0
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


def _loss(network: CandidateNetwork, examples: CandidateExamples, rows: np.ndarray, is_mirrored: bool) -> torch.Tensor:
    """Of what is in the way of reached candidates: object by object, and whether it is anything at all."""
    batch = batch_of(examples, rows, is_mirrored)
    truth = torch.from_numpy(examples.blockers[rows])
    blocks = network(batch).blocks
    pairs = binary_cross_entropy_with_logits(blocks[batch.is_present], truth[batch.is_present].float())
    log_free = torch.nn.functional.logsigmoid(-blocks).sum(1).clamp(max=-1e-6)
    is_free = ~truth.any(1)
    free = -torch.where(is_free, log_free, torch.log1p(-log_free.exp())).mean()
    return 10 * pairs + free


def _reach_loss(
    network: CandidateNetwork, examples: CandidateExamples, rows: np.ndarray, is_mirrored: bool
) -> torch.Tensor:
    batch = batch_of(examples, rows, is_mirrored)
    truth = torch.from_numpy(examples.is_reached[rows]).float()
    return binary_cross_entropy_with_logits(network.reach_logits(batch), truth)
