"""Examples for the high-level policy, the fit of its network, and rollouts without physics."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

from assets import FETCH
from clutter_env.policies.high_level.candidates import CandidateRule
from clutter_env.policies.high_level.network import CandidateNetwork
from clutter_env.policies.high_level.policy import LearnedHighLevelPolicy
from clutter_env.scene.layout import find_layout
from clutter_env.task import Task
from scripts.shipped_weights.decision_examples import (
    CandidateExamples,
    after_contact,
    examples_of_scene,
    label,
    roll_out,
    scene_of,
    visited_examples,
)
from scripts.shipped_weights.decisions import accuracy, batch_of, fit_high_level

RULE = CandidateRule(FETCH, find_layout("paper"))
TASK = Task("clutter_env/Retrieve-o5-v0")


@pytest.fixture(scope="module")
def env() -> gym.Env[Any, Any]:
    return TASK.make()


@pytest.fixture(scope="module")
def examples(env: gym.Env[Any, Any]) -> CandidateExamples:
    parts = []
    for seed in range(2):
        env.reset(seed=seed)
        parts.append(examples_of_scene(scene_of(env), RULE, np.random.default_rng(seed)))
    return CandidateExamples.joined(parts)


@pytest.fixture(scope="module")
def network(examples: CandidateExamples) -> CandidateNetwork:
    return fit_high_level(examples, 60, network=CandidateNetwork(32), learning_rate=1e-2)


def test_a_label_does_not_depend_on_the_other_candidates(env: gym.Env[Any, Any]) -> None:
    env.reset(seed=3)
    scene = scene_of(env)
    picks = RULE.picks(scene.objects)
    some = picks.take(np.arange(0, len(picks), 20))
    together = label(scene, some, scene.objects)
    alone = [label(scene, some.take(slice(row, row + 1)), scene.objects) for row in range(len(some))]
    assert together.is_reached.tolist() == [one.is_reached[0] for one in alone]
    assert together.blockers.tolist() == [one.blockers[0] for one in alone]
    assert together.is_free.any()
    assert not together.is_free.all()


def test_a_placed_object_stands_where_the_candidate_says(env: gym.Env[Any, Any]) -> None:
    env.reset(seed=3)
    scene = scene_of(env)
    picks = RULE.picks(scene.objects)
    free = int(np.flatnonzero(label(scene, picks, scene.objects).is_free)[0])
    pick = picks.contact(free, "pick", scene.objects[picks.index[free]].name)
    holding = after_contact(scene, pick)
    assert holding.held is not None
    body, points = scene.body(pick.object), RULE.points()
    places = RULE.places(body, holding.held, points)
    for row in (0, len(places) // 2, len(places) - 1):
        placed = after_contact(holding, places.contact(row, "place", body.name)).body(body.name)
        assert np.allclose(placed.position[:2], points[places.index[row], :2])
        assert placed.bottom == pytest.approx(scene.support.top)


@pytest.mark.slow
def test_neither_order_nor_absent_objects_matter(examples: CandidateExamples, network: CandidateNetwork) -> None:
    batch, order = batch_of(examples, np.arange(40)), torch.tensor([3, 0, 4, 1, 2])
    permuted = batch._replace(others=batch.others[:, order], is_present=batch.is_present[:, order])
    others = torch.where(batch.is_present[..., None], batch.others, torch.tensor(0.3))
    with torch.no_grad():
        one, other = network(batch), network(permuted)
        assert torch.equal(network(batch._replace(others=others)), one)
    assert torch.allclose(one[:, order], other, atol=1e-5)


@pytest.mark.slow
def test_fitting_learns(examples: CandidateExamples, network: CandidateNetwork) -> None:
    untrained, trained = accuracy(CandidateNetwork(32), examples), accuracy(network, examples)
    reached = examples.is_reached
    pairs = batch_of(examples, reached.nonzero()[0]).is_present.numpy().sum()
    always_clear = 1 - examples.blockers[reached].sum() / pairs
    assert trained["blocks"] > max(untrained["blocks"], always_clear + 0.01)
    assert trained["reach"] > max(untrained["reach"], reached.mean())


@pytest.mark.slow
def test_the_states_that_the_learner_visits_are_labelled(env: gym.Env[Any, Any], network: CandidateNetwork) -> None:
    _, info = env.reset(seed=1)
    rollout = roll_out(LearnedHighLevelPolicy(network, RULE), scene_of(env), info["target"])
    examples = list(visited_examples([rollout], RULE, np.random.default_rng(0)))
    assert len(examples) == len(rollout.decisions) > 0
