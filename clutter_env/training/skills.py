"""Cloning of the skills that lead to the target, before reinforcement learning improves the clone.

Examples are scenes with what is in the way of every grasp, found from the grasps in a scene without motions, and the
good skills that follow. Every object of a scene is the target once.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from operator import or_
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn.functional import binary_cross_entropy_with_logits

from clutter_env.envs.skill import BODY_FIELDS, SKILL_COST
from clutter_env.errors import DatasetError
from clutter_env.policies.skill_network import YAWS, YAWS_OF_DIRECTION, GraspScores, SkillNetwork
from clutter_env.training.descent import ExampleArrays, Report, RunLog, descend
from clutter_env.training.run import Run
from clutter_env.training.settings import PPO
from planners import DIRECTIONS, Scene, SkillPlanner, generate_grasps

MAX_CLEARANCES = 4
"""Scenes that need more clearances get no labels: the search grows with the power of their number."""
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


def clone_skills(run: Run, settings: PPO, model: Any, log: RunLog) -> None:
    """Fit the network of a new model to the good skills of `clone_scenes` scenes, the same ones for all seeds of a run.

    The labels are written to the run's directory as they are found; those that are there are not made again.
    """
    env = run.task.make()
    parts = []
    _, scenes = settings.scene_seeds(run.seed)
    for start in range(0, len(scenes), _SCENES_OF_A_FILE):
        seeds = scenes[start : start + _SCENES_OF_A_FILE]
        collect = partial(collect_scenes, env, seeds, np.random.default_rng(start))
        parts.append(LabelledScenes.kept(run.directory / "scenes" / f"{seeds[0]}-{seeds[-1]}.npz", collect))
    env.close()
    examples = SkillExamples.of(LabelledScenes.joined(parts))
    network, value = model.policy.mlp_extractor, model.policy.value_net
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
    counts = np.bincount(examples.clearances, minlength=len(_SHARES))
    weights = (np.array(_SHARES) / np.maximum(counts, 1))[examples.clearances]
    used = np.unique(examples.scene)

    def loss_at(step: int) -> torch.Tensor:
        scenes = rng.choice(used, _SCENES)
        grasps = network.grasps(torch.from_numpy(examples.scenes.bodies[scenes]))
        loss = _grasp_loss(grasps, examples, scenes)
        if step % _CHOICES_EVERY:
            return loss
        rows = np.concatenate([_drawn(examples, weights, scene, rng) for scene in scenes])
        of_choices = GraspScores(*(part.repeat_interleave(_CHOICES, dim=0) for part in grasps))
        # Shares of the budget that are left, from what good skills need up to all.
        left = rng.uniform((examples.clearances[rows] + 1) / (MAX_CLEARANCES + 3), 1).astype(np.float32)
        states = _States(examples, rows, torch.from_numpy(left))
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


def _drawn(
    examples: SkillExamples, weights: NDArray[np.float64], scene: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """`_CHOICES` choices in a scene."""
    first, last = np.searchsorted(examples.scene, (scene, scene + 1))
    of_scene = weights[first:last]
    return np.asarray(first + rng.choice(last - first, _CHOICES, p=of_scene / of_scene.sum()))


@dataclass(frozen=True, eq=False)
class LabelledScenes(ExampleArrays):
    """k scenes of n objects with the grasps of all objects.

    Attributes:
        bodies: (k, n, f) `BODY_FIELDS` of the observation.
        is_reachable: (k, n, yaws) whether there is a grasp at that yaw, whatever stands in its way.
        masks: (k, n, yaws) objects in the way of the grasp with the fewest, bit j for object j; 0 where there is none.
    """

    bodies: NDArray[np.float32]
    is_reachable: NDArray[np.bool_]
    masks: NDArray[np.int64]


def collect_scenes(env: gym.Env[Any, Any], seeds: Sequence[int], rng: np.random.Generator) -> LabelledScenes:
    """One scene for every seed of a kinematic Skill environment: as drawn, or after some random clearing skills."""
    skills: Any = env.unwrapped
    bodies: list[NDArray[np.float32]] = []
    grasps: list[tuple[NDArray[np.bool_], NDArray[np.int64]]] = []
    planner: SkillPlanner | None = None
    for seed in seeds:
        observation, _ = env.reset(seed=seed)
        planner = planner or SkillPlanner.of(skills.scene)
        for _ in range(rng.integers(skills.budget)):
            clearing = np.flatnonzero(skills.action_masks(geometric=False)[:-1])
            observation, *_ = env.step(int(rng.choice(clearing)))
        rows = observation[:-2].reshape(len(skills.scene.names), len(BODY_FIELDS) + DIRECTIONS)
        bodies.append(rows[:, : len(BODY_FIELDS)])
        grasps.append(grasp_obstacles(planner, skills.scene))
    is_reachable, masks = (np.array(part) for part in zip(*grasps, strict=True))
    return LabelledScenes(np.array(bodies), is_reachable, masks)


def grasp_obstacles(planner: SkillPlanner, scene: Scene) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Reachable grasps (n, yaws) of a scene in which nothing is held, and masks of what is in their way.

    Yaws of boxes count as the nearest ones of round objects.
    """
    is_reachable = np.zeros((len(scene.objects), YAWS), dtype=np.bool_)
    masks = np.zeros(is_reachable.shape, dtype=np.int64)
    for i, body in enumerate(scene.objects):
        for pose in generate_grasps(body, scene.robot):
            yaw = round(pose.yaw / (2 * math.pi / YAWS)) % YAWS
            found = [grasp.blockers for grasp in planner.candidates(scene, body, [pose])]
            if is_reachable[i, yaw]:
                found.append(int(masks[i, yaw]))
            if found:
                is_reachable[i, yaw], masks[i, yaw] = True, min(found, key=int.bit_count)
    return is_reachable, masks


@dataclass(frozen=True, eq=False)
class SkillExamples:
    """k choices in labelled scenes, all of which have a good skill.

    Attributes:
        scenes: the scenes.
        scene: (k,) index of the scene of each choice.
        target: (k,) index of the target.
        is_good, is_free: (k, m) see `SkillLabels`.
        clearances: (k,) see `SkillLabels`.
    """

    scenes: LabelledScenes
    scene: NDArray[np.int64]
    target: NDArray[np.int64]
    is_good: NDArray[np.bool_]
    is_free: NDArray[np.bool_]
    clearances: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.scene)

    @classmethod
    def of(cls, scenes: LabelledScenes) -> SkillExamples:
        """All choices with a good skill, every object of every scene being the target once.

        Raises:
            DatasetError: there are none.
        """
        found = [
            (scene, target, skill_labels(scenes.is_reachable[scene], scenes.masks[scene], target))
            for scene in range(len(scenes.bodies))
            for target in np.flatnonzero(scenes.bodies[scene, :, _PRESENT]).tolist()
        ]
        kept = [(scene, target, *labels) for scene, target, labels in found if labels.is_good.any()]
        if not kept:
            raise DatasetError("none of these scenes has a good skill; use more of them")
        return cls(scenes, *(np.array(column) for column in zip(*kept, strict=True)))

    def bodies(self, rows: NDArray[np.int64]) -> NDArray[np.float32]:
        """(k, n, f) `BODY_FIELDS` of some choices, their targets marked."""
        bodies = self.scenes.bodies[self.scene[rows]].copy()
        bodies[..., _IS_TARGET] = 0
        bodies[np.arange(len(rows)), self.target[rows], _IS_TARGET] = 1
        return bodies


class SkillLabels(NamedTuple):
    """Labels of the skills in one scene; their order is that of the actions of `Skill`.

    Attributes:
        is_good: (m,) free skills after which the fewest clearances are left; none if there is no solution.
        is_free: (m,) whether the skill has a grasp with nothing in its way.
        clearances: how many are needed before the target is free; -1 if more than `MAX_CLEARANCES`, or if there is no
            solution.
    """

    is_good: NDArray[np.bool_]
    is_free: NDArray[np.bool_]
    clearances: int


def skill_labels(is_reachable: NDArray[np.bool_], masks: NDArray[np.int64], target: int) -> SkillLabels:
    """The labels of a scene in which nothing is held, from its grasps (n, yaws); see `grasp_obstacles`.

    Cleared objects are taken to be in nothing's way: they are put where they keep clear of the target's grasp.
    """
    is_free_yaw = is_reachable & (masks == 0)
    takes = is_free_yaw[target].any()
    clears = is_free_yaw[:, YAWS_OF_DIRECTION].any(axis=2)
    clears[target] = False
    in_the_way = [set(row[reached].tolist()) for row, reached in zip(masks, is_reachable, strict=True)]
    clearances, first = clearances_left(in_the_way, target)
    is_helpful = np.array([bool(first >> i & 1) for i in range(len(clears))])
    return SkillLabels(np.append(clears & is_helpful[:, None], takes), np.append(clears, takes), clearances)


def clearances_left(in_the_way: Sequence[set[int]], target: int) -> tuple[int, int]:
    """Fewest clearances before some grasp of the target is free, and the mask of objects with which they can begin.

    Args:
        in_the_way: for every object the masks of what is in the way of its grasps.
        target: its index.

    Returns:
        -1 and 0 if more than `MAX_CLEARANCES` are needed, or if none frees it.
    """
    matters = _matter(in_the_way, target)
    reached = {0: 0}  # what can be gone after `count` clearances, and the objects with which this can begin
    for count in range(MAX_CLEARANCES + 1):
        firsts = [first for gone, first in reached.items() if any(not mask & ~gone for mask in in_the_way[target])]
        if firsts:
            return count, _union(firsts)
        after: dict[int, int] = {}
        for gone, first in reached.items():
            for i in matters:
                bit = 1 << i
                if not gone & bit and any(not mask & ~gone for mask in in_the_way[i]):
                    after[gone | bit] = after.get(gone | bit, 0) | (first if count else bit)
        reached = after
    return -1, 0


def _matter(in_the_way: Sequence[set[int]], target: int) -> list[int]:
    """The objects that may have to be cleared: in the way of the target, or of one of these; without the target."""
    found, new = 0, _union(in_the_way[target])
    while new:
        found |= new
        hidden = [row for i, row in enumerate(in_the_way) if new >> i & 1 and 0 not in row]
        new = _union(mask for row in hidden for mask in row) & ~found
    return [i for i in range(len(in_the_way)) if found >> i & 1 and i != target]


def _union(masks: Iterable[int]) -> int:
    return reduce(or_, masks, 0)
