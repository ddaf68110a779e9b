"""The learned high-level policy: candidates, what an observation shows, costs, and decisions."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from assets import FETCH
from clutter_env.policies.high_level.candidates import MIN_STANDOFF, CandidateRule, object_rows, observed_scene
from clutter_env.policies.high_level.policy import MAX_COST, RISK, LearnedHighLevelPolicy, clearing_costs
from clutter_env.policies.parsed_observation import planar_pose
from clutter_env.policies.weights import shipped_path
from clutter_env.scene.layout import find_layout
from scripts.shipped_weights.decision_examples import after_contact, as_observed, scene_of

Env = gym.Env[Any, Any]
RULE = CandidateRule(FETCH, find_layout("paper"))


@pytest.fixture
def policy() -> LearnedHighLevelPolicy:
    return LearnedHighLevelPolicy.load(shipped_path("decisions", "side"))


def test_an_observation_shows_the_scene_in_the_world(env: Env) -> None:
    observation, info = env.reset(seed=3)
    seen, scene = observed_scene(observation), scene_of(env)
    assert seen.bodies[seen.target].name == info["target"]
    assert np.allclose(object_rows(seen.bodies), object_rows(scene.objects), atol=1e-5)
    assert np.allclose(seen.base, scene.state.base, atol=1e-6)
    assert seen.held is None
    assert seen.is_standing.all()


def test_bases_face_the_gripper_and_keep_off_the_table(env: Env) -> None:
    env.reset(seed=3)
    scene = scene_of(env)
    picks = RULE.picks(scene.objects)
    away = picks.tcp[:, :2] - picks.base[:, :2]
    assert np.allclose(np.arctan2(away[:, 1], away[:, 0]), picks.base[:, 2])
    assert np.linalg.norm(away, axis=1).min() >= MIN_STANDOFF - 1e-9
    assert picks.base[:, 0].max() < -RULE.layout.depth / 2 - FETCH.base_radius
    assert len(np.unique(picks.index)) == len(scene.objects)


def test_candidates_mirror_left_to_right(env: Env) -> None:
    env.reset(seed=3)
    bodies = scene_of(env).objects
    one, other = RULE.picks(bodies), RULE.picks([body.at(body.position * (1, -1, 1)) for body in bodies])
    rounded = [np.round(np.column_stack((found.index, found.base)), 6) for found in (one, other)]
    rounded[1][:, 2:] *= -1
    assert {tuple(row) for row in rounded[0] + 0.0} == {tuple(row) for row in rounded[1] + 0.0}


def test_value_iteration_counts_clearances() -> None:
    """Object 0 is behind 1, which is behind 2; object 3 stands alone; 4 and 5 block each other."""
    blocks = np.zeros((1, 6, 6))
    for behind, before in ((0, 1), (1, 2), (4, 5), (5, 4)):
        blocks[0, behind, before] = 1.0
    costs = clearing_costs(np.arange(6), np.zeros(6), blocks)
    assert costs.objects[0].tolist() == [2.0, 1.0, 0.0, 0.0, RISK, RISK]
    assert costs.is_cleared[0].nonzero()[0].tolist() == [0, 1]
    assert (costs.objects <= MAX_COST).all()


def test_it_picks_an_object_and_places_it_with_clearance(env: Env, policy: LearnedHighLevelPolicy) -> None:
    observation, _ = env.reset(seed=1)
    scene = scene_of(env)
    pick = policy.decide(observation)
    assert pick is not None
    assert pick.skill == "pick"
    other = next(name for name in scene.names if name != pick.object)
    holding = after_contact(scene, pick)
    place = policy.choose(as_observed(holding, other))
    assert place is not None
    assert (place.skill, place.object) == ("place", pick.object)
    placed = after_contact(holding, place).body(pick.object)
    others = [body.position[:2] for body in scene.objects if body.name != placed.name]
    assert np.linalg.norm(np.array(others) - placed.position[:2], axis=1).min() > 0.06
    assert policy.choose(as_observed(holding, pick.object)) is None
    assert not policy.failure


def test_after_a_failure_it_decides_otherwise(env: Env, policy: LearnedHighLevelPolicy) -> None:
    observation, info = env.reset(seed=1)
    chosen = [policy.decide(observation) for _ in range(3)]
    poses = {tuple(np.round([*one.base, *one.tcp[:2, 3]], 6)) for one in chosen if one is not None}
    assert len(poses) == 3
    policy.reset(info)
    again = policy.decide(observation)
    assert again is not None
    assert np.array_equal(again.base, chosen[0].base)  # type: ignore[union-attr]  # it is not None, see above


def test_what_failed_is_not_tried_again_after_another_object_has_moved(
    env: Env, policy: LearnedHighLevelPolicy
) -> None:
    """It was, with one object taken and put down in between, until the budget was spent."""
    observation, _ = env.reset(seed=1)
    scene = observed_scene(observation)
    failed = policy.choose(scene)
    assert failed is not None
    other = next(body for body in scene.bodies if body.name != failed.object)
    moved = other.at_pose(planar_pose(np.array((-0.3, 0.45, 0.0))) @ other.pose)
    policy.choose(replace(scene, bodies=tuple(moved if body is other else body for body in scene.bodies)))
    again = policy.choose(scene)
    assert again is not None
    assert not np.allclose((*again.base, *again.tcp.ravel()), (*failed.base, *failed.tcp.ravel()))


def test_it_gives_up_when_nothing_is_left(env: Env, policy: LearnedHighLevelPolicy) -> None:
    observation, _ = env.reset(seed=1)
    policy.rule = replace(RULE, layout=replace(find_layout("paper"), depth=3.0))
    assert policy.decide(observation) is None
    assert policy.failure


@pytest.mark.parametrize(("keywords", "others"), [({}, 0), ({"object_set": "tall"}, 3), ({"shapes": "mixed"}, 2)])
def test_objects_that_it_was_not_trained_with_are_named_once(
    keywords: dict[str, str], others: int, policy: LearnedHighLevelPolicy, caplog: pytest.LogCaptureFixture
) -> None:
    """Of the tall ones two are 20 cm high, as standard ones may be."""
    with closing(gym.make("clutter_env/Retrieve-o5-v0", **keywords)) as env:  # type: ignore[arg-type]  # keywords of ours
        for seed in range(2):
            observation, info = env.reset(seed=seed)
            policy.reset(info)
            policy.decide(observation)
    assert caplog.text.count("object_") == others
    assert len(caplog.records) == bool(others)
