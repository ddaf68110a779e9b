"""Commitments can be carried out in their order, and objects are put where they leave the chosen grasps free."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planners.clearing.commitments import (
    ClearingProblem,
    Commitments,
    NoCommitment,
    grasped,
    greedy_commitments,
    smallest_commitments,
)
from planners.clearing.lookahead import keep_clear
from planners.collision.world import CollisionWorld
from planners.context import PlanningContext
from planners.scene import Scene
from planners.strategies import STRATEGIES
from tests.planners.scenes import random_scene


@pytest.fixture(scope="module", params=[0, 1])
def problem(request: pytest.FixtureRequest) -> ClearingProblem:
    """The choice of grasps in a random scene, for its first object."""
    scene = random_scene(25, request.param)
    context = PlanningContext.of(scene.robot, scene, grasps="side")
    rng = np.random.default_rng(0)
    return ClearingProblem(context.grasps(), context.placements(), scene, scene.names[0], STRATEGIES["lookahead"], rng)


def for_targets(problem: ClearingProblem, count: int) -> list[ClearingProblem]:
    return [dataclasses.replace(problem, target=name) for name in problem.scene.names[:count]]


def test_commitments_can_be_carried_out_in_their_order(problem: ClearingProblem) -> None:
    for one in for_targets(problem, 6):
        smallest, greedy = next(smallest_commitments(one)), greedy_commitments(one)
        if isinstance(smallest, NoCommitment) or isinstance(greedy, NoCommitment):
            assert isinstance(smallest, NoCommitment)
            continue
        assert len(smallest.order) <= len(greedy.order)
        for commitments in (smallest, greedy):
            assert_can_be_carried_out(one.scene, commitments)


def assert_can_be_carried_out(scene: Scene, commitments: Commitments) -> None:
    removed = 0
    for name in (*commitments.order, commitments.target):
        assert commitments.grasps[name].blockers & ~removed == 0
        removed |= scene.mask([name])
    assert set(commitments.grasps) == {*commitments.order, commitments.target}


@pytest.mark.parametrize("name", STRATEGIES)
def test_placements_hit_nothing_and_keep_clear(name: str, problem: ClearingProblem) -> None:
    scene, strategy = problem.scene, STRATEGIES[name]
    found = (next(smallest_commitments(one)) for one in for_targets(problem, len(scene.names)))
    commitments = next(one for one in found if isinstance(one, Commitments) and one.order)
    first = commitments.order[0]
    in_hand = grasped(scene, commitments.grasps[first])
    guarded = keep_clear(strategy, commitments, first)
    world = CollisionWorld.from_scene(in_hand)
    placement = next(problem.placements.find(world, guarded, strategy, np.random.default_rng(0)))
    assert np.all(np.abs(placement.location - scene.support.position[:2]) < scene.support.half_extents[:2])
    assert world.hits(placement.base, placement.q, placement.opening, held=in_hand.held) == 0
    after = CollisionWorld.from_scene(scene.with_body(placement.body))
    bit = scene.mask([first])
    for grasp in filter(None, (guarded.target, *guarded.obstacles)):
        assert not after.hits(grasp.base, grasp.q, grasp.opening) & bit


def test_an_object_left_alone_is_not_cleared(problem: ClearingProblem) -> None:
    for one in for_targets(problem, 6):
        found = next(smallest_commitments(one))
        if isinstance(found, Commitments) and found.order:
            other = next(smallest_commitments(dataclasses.replace(one, left_alone=frozenset(found.order[:1]))))
            assert isinstance(other, NoCommitment) or found.order[0] not in other.order
