"""Cloning of the skills that lead to the target, before reinforcement learning improves the clone."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn.functional import binary_cross_entropy_with_logits

from clutter_env.envs.skill import BODY_FIELDS, SKILL_COST
from clutter_env.policies.skill_network import GraspScores, SkillNetwork
from clutter_env.training.descent import Report, RunLog, descend
from clutter_env.training.run import Run
from clutter_env.training.settings import PPO
from clutter_env.training.skill_examples import MAX_CLEARANCES, LabelledScenes, SkillExamples, collect_scenes
from planners import DIRECTIONS

_SCENES_OF_A_FILE = 100
_PRESENT, _IS_TARGET = BODY_FIELDS.index("present"), BODY_FIELDS.index("is_target")
_OUT = -1e9
"""Logit of a skill that is not worth trying."""
_SCENES, _CHOICES = 16, 4
"""Scenes in a gradient step, and choices of each of them."""
_LEARNING_RATE = 2e-3
_VALUE_WEIGHT = 0.5
_SHARES = (0.2, 0.3, 0.3, 0.15, 0.05)
"""Weights of all choices together that need 0, 1, … clearances, when choices are drawn within a scene."""
_CHOICES_EVERY = 2
"""Steps of which one also learns choices: most of what there is to learn is geometry, and cheap."""
_REFUSALS = 2
"""Skills of the network's own choice tried at most before the one that is learned: refusals are seen too."""


def clone_skills(run: Run, settings: PPO, model: Any) -> None:
    """Fit the network of a new model to the good skills of `clone_scenes` scenes, the same ones for all seeds of a run.

    The labels are written to the run's directory as they are found; those that are there are not made again.
    """
    folder = run.directory / "scenes"
    folder.mkdir(exist_ok=True)
    env = run.task.make()
    parts = []
    for start in range(0, settings.clone_scenes, _SCENES_OF_A_FILE):
        seeds = range(start, min(settings.clone_scenes, start + _SCENES_OF_A_FILE))
        path = folder / f"{seeds[0]}-{seeds[-1]}.npz"
        if not path.exists():
            collect_scenes(env, seeds, np.random.default_rng(start)).save(path)
        parts.append(LabelledScenes.load(path))
    env.close()
    examples = SkillExamples.of(LabelledScenes.joined(parts))
    network, value = model.policy.mlp_extractor, model.policy.value_net
    with RunLog(run) as log:
        fit_skills(network, examples, settings.clone_steps, run.seed, value, log.loss)


def fit_skills(
    network: SkillNetwork,
    examples: SkillExamples,
    steps: int,
    seed: int = 0,
    value: nn.Module | None = None,
    report: Report = lambda *_: None,
) -> None:
    """Fit a network to examples.

    The loss of a scene is the cross entropy of what the arm reaches and of what is in the way. The loss of a choice is
    minus the log of the probability that it is good, any good skill being as welcome, after some skills of the
    network's own have been refused; beside it the error of the value, which is taken to be the reward of good skills to
    the end.

    Args:
        network: is changed.
        examples: at least one.
        steps: gradient steps.
        seed: random seed.
        value: from the features of a state (k, w) to its value (k, 1), fitted too; None if there is none.
        report: called with the step and the loss every 500 steps.
    """
    rng = np.random.default_rng(seed)
    torch.manual_seed(seed)
    fitted = [*network.parameters(), *([] if value is None else value.parameters())]
    optimiser = torch.optim.AdamW(fitted, lr=_LEARNING_RATE, weight_decay=1e-4)
    weights = _weights(examples)
    used = np.unique(examples.scene)

    def loss_at(step: int) -> torch.Tensor:
        scenes = rng.choice(used, _SCENES)
        grasps = network.grasps(torch.from_numpy(examples.scenes.bodies[scenes]))
        loss = _grasp_loss(grasps, examples, scenes)
        if step % _CHOICES_EVERY:
            return loss
        rows = np.concatenate([_drawn(examples, weights, scene, rng) for scene in scenes])
        of_choices = GraspScores(*(part.repeat_interleave(_CHOICES, dim=0) for part in grasps))
        states = _States(examples, rows, torch.from_numpy(_budget_left(examples.clearances[rows], rng)))
        states.try_skills(network, of_choices, torch.from_numpy(rng.integers(_REFUSALS + 1, size=len(rows))))
        raw, whole = network.choose(states.observation(), of_choices)
        logits = raw.masked_fill(~states.allowed, _OUT)
        chance = torch.logsumexp(logits.masked_fill(~states.good, _OUT), 1) - torch.logsumexp(logits, 1)
        loss = loss - chance.mean()
        if value is not None:
            loss = loss + _VALUE_WEIGHT * nn.functional.mse_loss(value(whole)[:, 0], states.returns)
        return loss

    descend(optimiser, steps, loss_at, report, max_gradient=1.0)


class _States:
    """States of choices, in which skills are refused.

    Attributes:
        allowed: (k, m) skills worth trying: those that can be and have not been refused.
        good: (k, m) good skills.
        returns: (k,) reward of good skills to the end.
    """

    def __init__(self, examples: SkillExamples, rows: NDArray[np.int64], left: torch.Tensor) -> None:
        self._bodies, self._left = torch.from_numpy(examples.bodies(rows)), left
        clearable = self._bodies[..., _PRESENT] * (1 - self._bodies[..., _IS_TARGET]) > 0
        taking = torch.ones(len(rows), 1, dtype=torch.bool)
        self.allowed = torch.cat((clearable.repeat_interleave(DIRECTIONS, dim=1), taking), dim=1)
        self.good, self._free = torch.from_numpy(examples.is_good[rows]), torch.from_numpy(examples.is_free[rows])
        self._failed = torch.zeros_like(self.allowed)
        self.returns = 1 - SKILL_COST * (1 + torch.from_numpy(examples.clearances[rows]).float())

    def observation(self) -> torch.Tensor:
        """(k, f) as the environment gives it."""
        k, n, _ = self._bodies.shape
        flags = self._failed.float()
        rows = torch.cat((self._bodies, flags[:, :-1].reshape(k, n, DIRECTIONS)), dim=2)
        return torch.cat((rows.flatten(1), self._left[:, None], flags[:, -1:]), dim=1)

    @torch.no_grad()
    def try_skills(self, network: SkillNetwork, grasps: GraspScores, counts: torch.Tensor) -> None:
        """Draw skills from the network, `counts` (k,) of them; those that are not free are refused."""
        for count in range(int(counts.max())):
            logits = network.choose(self.observation(), grasps)[0].masked_fill(~self.allowed, _OUT)
            tried = torch.distributions.Categorical(logits=logits).sample()[:, None]
            is_refused = ~self._free.gather(1, tried)[:, 0] & (counts > count)
            refused = torch.zeros_like(self.allowed).scatter(1, tried, is_refused[:, None])
            self._failed |= refused
            self.allowed &= ~refused


def _grasp_loss(grasps: GraspScores, examples: SkillExamples, scenes: NDArray[np.int64]) -> torch.Tensor:
    """Cross entropy a grasp: of what is reached, and of everything that may be in the way where it is."""
    reached = torch.from_numpy(examples.scenes.is_reachable[scenes])
    present = torch.from_numpy(examples.scenes.bodies[scenes][..., _PRESENT]) > 0
    masks = torch.from_numpy(examples.scenes.masks[scenes])
    blocks = (masks[..., None] >> torch.arange(masks.shape[1]) & 1).float()
    of_reach = binary_cross_entropy_with_logits(grasps.reach, reached.float(), reduction="none")[present].mean()
    pairs = ~torch.eye(masks.shape[1], dtype=torch.bool)[:, None] & present[:, None, None]
    of_pairs = binary_cross_entropy_with_logits(grasps.blocks, blocks, reduction="none") * pairs
    return of_reach + of_pairs.sum(3)[reached].mean()


def _weights(examples: SkillExamples) -> NDArray[np.float64]:
    """(k,) weights of choices within their scene: `_SHARES`, divided among those that need as many clearances."""
    counts = np.bincount(examples.clearances, minlength=len(_SHARES))
    return np.asarray((np.array(_SHARES) / np.maximum(counts, 1))[examples.clearances])


def _drawn(
    examples: SkillExamples, weights: NDArray[np.float64], scene: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """`_CHOICES` choices in a scene."""
    first, last = np.searchsorted(examples.scene, (scene, scene + 1))
    of_scene = weights[first:last]
    return np.asarray(first + rng.choice(last - first, _CHOICES, p=of_scene / of_scene.sum()))


def _budget_left(clearances: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.float32]:
    """Shares of the budget (k,), from what good skills need up to all."""
    least = (clearances + 1) / (MAX_CLEARANCES + 3)
    return np.asarray(rng.uniform(least, 1), np.float32)
