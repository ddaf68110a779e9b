"""Fits the network of skills to examples."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn
from torch.nn.functional import binary_cross_entropy_with_logits

from clutter_env.envs.skill import BODY_FIELDS, SKILL_COST
from clutter_env.learning.skills.examples import SkillExamples
from clutter_env.learning.skills.network import SkillNetwork
from planners.skills.geometry import DIRECTIONS

__all__ = ["FitConfig", "accuracy", "fit", "mirrored"]

_OUT = -1e9
"""Logit of a skill that is not worth trying."""
_VALUE_WEIGHT = 0.5


@dataclass(frozen=True)
class FitConfig:
    """How the network is fitted.

    Attributes:
        steps: gradient steps.
        seed: random seed.
        batch: states in a step.
        learning_rate: at the start; it falls to zero along a cosine.
        free_weight: of the loss of `SkillScores.free`, beside that of the choice.
    """

    steps: int = 3000
    seed: int = 0
    batch: int = 64
    learning_rate: float = 1e-3
    free_weight: float = 0.5


def fit(
    network: SkillNetwork,
    examples: SkillExamples,
    config: FitConfig,
    value: nn.Module | None = None,
    report: Callable[[int, float], None] = lambda *_: None,
) -> None:
    """Fit a network to examples, half of them mirrored left to right.

    The loss of a state is minus the log of the probability that the choice is good, any good skill being as welcome;
    beside it the cross entropy of free skills, where these are known, and the error of the value, which is taken to be
    the reward of good skills to the end.

    Args:
        network: is changed.
        examples: at least one.
        config: how.
        value: from the features of a state (k, w) to its value (k, 1), fitted too; None if there is none.
        report: is told step and loss from time to time.
    """
    rng = np.random.default_rng(config.seed)
    fitted = [*network.parameters(), *([] if value is None else value.parameters())]
    optimiser = torch.optim.AdamW(fitted, lr=config.learning_rate, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.LambdaLR(
        optimiser, lambda step: 0.5 * (1 + math.cos(math.pi * step / config.steps))
    )
    parts = _tensors(examples)
    returns = 1 - SKILL_COST * (1 + torch.from_numpy(examples.clearances).float())
    for step in range(config.steps):
        rows = torch.from_numpy(rng.integers(len(examples), size=config.batch))
        picked = [part[rows] for part in parts]
        seen, allowed, wanted, is_free, is_known = mirrored(*picked) if step % 2 else picked
        scores = network.scores(seen)
        logits = scores.logits.masked_fill(~allowed, _OUT)
        chance = torch.logsumexp(logits.masked_fill(~wanted, _OUT), 1) - torch.logsumexp(logits, 1)
        of_free = binary_cross_entropy_with_logits(scores.free, is_free.float(), reduction="none")[is_known].mean()
        loss = config.free_weight * of_free - chance.mean()
        if value is not None:
            loss = loss + _VALUE_WEIGHT * nn.functional.mse_loss(value(scores.whole)[:, 0], returns[rows])
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(fitted, 1.0)
        optimiser.step()
        schedule.step()
        if step % 50 == 0:
            report(step, loss.item())


@torch.no_grad()
def accuracy(network: SkillNetwork, examples: SkillExamples, batch: int = 256) -> float:
    """Share of the states in which the most probable skill is a good one."""
    observation, mask, good, _, _ = _tensors(examples)
    right = 0
    for first in range(0, len(examples), batch):
        part = slice(first, first + batch)
        chosen = network.scores(observation[part]).logits.masked_fill(~mask[part], _OUT).argmax(1)
        right += int(good[part].gather(1, chosen[:, None]).sum())
    return right / len(examples)


def _tensors(examples: SkillExamples) -> tuple[torch.Tensor, ...]:
    """Observations, masks, good, free and known skills; good ones are worth trying."""
    parts = (examples.observation, examples.mask, examples.is_good & examples.mask, examples.is_free, examples.is_known)
    return tuple(map(torch.from_numpy, parts))


def mirrored(observation: torch.Tensor, *of_skills: torch.Tensor) -> list[torch.Tensor]:
    """States (k, f) and what is known of their skills (k, m), with left and right exchanged."""
    turned = -torch.arange(DIRECTIONS) % DIRECTIONS
    count = (of_skills[0].shape[1] - 1) // DIRECTIONS
    rows = observation[:, :-2].reshape(len(observation), count, -1).clone()
    rows[..., BODY_FIELDS.index("y")] *= -1
    rows[..., len(BODY_FIELDS) :] = rows[..., len(BODY_FIELDS) :][..., turned]
    mirrored = [torch.cat((rows.flatten(1), observation[:, -2:]), dim=1)]
    for values in of_skills:
        clears = values[:, :-1].reshape(len(values), count, DIRECTIONS)[..., turned]
        mirrored.append(torch.cat((clears.flatten(1), values[:, -1:]), dim=1))
    return mirrored
