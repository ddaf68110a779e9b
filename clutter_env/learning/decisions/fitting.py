"""Fits the network of decisions to examples of contacts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch.nn.functional import binary_cross_entropy_with_logits

from clutter_env.learning.decisions.examples import ContactExamples
from clutter_env.learning.decisions.network import ContactBatch, ContactNetwork
from clutter_env.learning.errors import LearningError
from clutter_env.learning.regression.descent import DescentConfig, Report, descend

__all__ = ["Accuracy", "FitConfig", "accuracy", "batch_of", "fit"]

_REACH_SHARE = 8
"""Contacts in a batch for each one of those that are reached: most of them are not, and cost little."""


@dataclass(frozen=True)
class FitConfig(DescentConfig):
    """Settings; `batch` counts the reached contacts in each step."""

    steps: int = 6000
    learning_rate: float = 2e-3
    width: int = 96


@dataclass(frozen=True)
class Accuracy:
    """Shares of right answers.

    Attributes:
        reach: among all contacts.
        blocks: among the pairs of a reached contact and an object.
        free: among reached contacts, whether they are free.
        precision: share of the contacts called free that are; NaN if there are none.
        recall: share of the free contacts that are called free; NaN if there are none.
    """

    reach: float
    blocks: float
    free: float
    precision: float
    recall: float


def fit(
    examples: ContactExamples,
    config: FitConfig = FitConfig(),
    network: ContactNetwork | None = None,
    report: Report = lambda *_: None,
) -> ContactNetwork:
    """Fit a network; half of the batches are mirrored left to right, which changes no label.

    Args:
        examples: to learn from.
        config: settings.
        network: is changed; a new one if not given.
        report: called with the step and the loss every 500 steps.

    Raises:
        LearningError: no contact of the examples is reached.
    """
    torch.manual_seed(config.seed)
    rng = np.random.default_rng(config.seed)
    reached = np.flatnonzero(examples.is_reached)
    if not len(reached):
        raise LearningError("no contact of the examples is reached: there is nothing to learn from")
    fitted = ContactNetwork(config.width) if network is None else network

    def loss(step: int) -> torch.Tensor:
        """Of a random batch."""
        is_mirrored = bool(step % 2)
        of_blockers = _loss(fitted, examples, rng.choice(reached, config.batch), is_mirrored)
        rows = rng.integers(len(examples), size=_REACH_SHARE * config.batch)
        return of_blockers + _reach_loss(fitted, examples, rows, is_mirrored)

    optimiser = torch.optim.AdamW(fitted.parameters(), lr=config.learning_rate, weight_decay=1e-4)
    descend(optimiser, config.steps, loss, report)
    return fitted


def accuracy(network: ContactNetwork, examples: ContactExamples, most: int = 20_000) -> Accuracy:
    """How often the network is right on examples, at most so many of each kind."""
    rng = np.random.default_rng(0)
    every = rng.permutation(len(examples))[:most]
    reached = rng.permutation(np.flatnonzero(examples.is_reached))[:most]
    with torch.no_grad():
        reach = network(batch_of(examples, every)).reach.numpy() > 0
        blocks = network(batch_of(examples, reached)).blocks.numpy() > 0
    truth, is_present = examples.blockers[reached], batch_of(examples, reached).is_present.numpy()
    is_free, is_called_free = ~truth.any(axis=1), ~blocks.any(axis=1)
    return Accuracy(
        reach=float(np.mean(reach == examples.is_reached[every])),
        blocks=float(np.mean((blocks == truth)[is_present])),
        free=float(np.mean(is_free == is_called_free)),
        precision=_share(is_free[is_called_free]),
        recall=_share(is_called_free[is_free]),
    )


def _share(values: np.ndarray) -> float:
    """The share that is true; NaN of nothing."""
    return float(values.mean()) if len(values) else math.nan


def batch_of(examples: ContactExamples, rows: np.ndarray, is_mirrored: bool = False) -> ContactBatch:
    """Some contacts for the network; mirrored, y and yaws have the other sign."""
    others = torch.from_numpy(examples.objects[examples.scene[rows]])
    index = torch.arange(others.shape[1])
    is_present = (others[..., 3] > 0) & (index != torch.from_numpy(examples.own_index[rows].astype(np.int64))[:, None])
    own, tcp, base = (torch.from_numpy(column[rows]) for column in (examples.own, examples.tcp, examples.base))
    if is_mirrored:
        side = torch.tensor((1.0, -1.0, 1.0, 1.0, 1.0))
        own, others = own * side, others * side
        tcp, base = tcp * torch.tensor((1.0, -1.0, 1.0, -1.0, 1.0)), base * torch.tensor((1.0, -1.0, -1.0))
    return ContactBatch(own, tcp, base, others, is_present)


def _loss(network: ContactNetwork, examples: ContactExamples, rows: np.ndarray, is_mirrored: bool) -> torch.Tensor:
    """Of what is in the way of reached contacts: object by object, and whether it is anything at all."""
    batch = batch_of(examples, rows, is_mirrored)
    truth = torch.from_numpy(examples.blockers[rows])
    blocks = network(batch).blocks
    pairs = binary_cross_entropy_with_logits(blocks[batch.is_present], truth[batch.is_present].float())
    log_free = torch.nn.functional.logsigmoid(-blocks).sum(1).clamp(max=-1e-6)
    is_free = ~truth.any(1)
    free = -torch.where(is_free, log_free, torch.log1p(-log_free.exp())).mean()
    return 10 * pairs + free


def _reach_loss(
    network: ContactNetwork, examples: ContactExamples, rows: np.ndarray, is_mirrored: bool
) -> torch.Tensor:
    batch = batch_of(examples, rows, is_mirrored)
    truth = torch.from_numpy(examples.is_reached[rows]).float()
    return binary_cross_entropy_with_logits(network.reach_logits(batch), truth)
