"""Commitments can be carried out in their order, and objects are put where they leave the chosen grasps free."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest

from planners.clearing.commitments import Commitments, NoCommitment, commitments_for, grasped, keep_clear
from planners.collision.world import CollisionWorld
from planners.grasping.candidates import GraspCandidates
from planners.placing.placements import PlacementSearch
from planners.scene import Scene
from planners.strategies import STRATEGIES, Strategy
from planners.workspace import Workspace
from tests.planners.scenes import random_scene

GREEDY = STRATEGIES["ngr"]
SMALLEST = Strategy("smallest", "smallest", "ngr", "priority")


class Known(NamedTuple):
    scene: Scene
    candidates: GraspCandidates
    placements: PlacementSearch

    def commitments(self, target: str, strategy: Strategy) -> Commitments | NoCommitment:
        return commitments_for(lambda name: self.candidates.for_object(self.scene, name), self.scene, target, strategy)

    def each(self) -> Iterator[Commitments]:
        """Commitments that clear something."""
        for name in self.scene.names:
            found = self.commitments(name, SMALLEST)
            if isinstance(found, Commitments) and found.order:
                yield found


@pytest.fixture(scope="module", params=[0, 1])
def known(request: pytest.FixtureRequest) -> Known:
    """Grasps and placements in a random scene."""
    scene = random_scene(25, request.param)
    workspace = Workspace.of(scene.robot, scene, grasps="side")
    return Known(scene, workspace.grasps(), workspace.placements())


def test_commitments_can_be_carried_out_in_their_order(known: Known) -> None:
    for name in known.scene.names[:6]:
        smallest, greedy = known.commitments(name, SMALLEST), known.commitments(name, GREEDY)
        if isinstance(smallest, NoCommitment) or isinstance(greedy, NoCommitment):
            assert isinstance(smallest, NoCommitment)
            continue
        assert len(smallest.order) <= len(greedy.order)
        for commitments in (smallest, greedy):
            assert_can_be_carried_out(known.scene, commitments)


def assert_can_be_carried_out(scene: Scene, commitments: Commitments) -> None:
    removed = 0
    for name in (*commitments.order, commitments.target):
        assert commitments.grasps[name].blockers & ~removed == 0
        removed |= scene.mask([name])
    assert set(commitments.grasps) == {*commitments.order, commitments.target}


@pytest.mark.parametrize("name", STRATEGIES)
def test_placements_hit_nothing_and_keep_clear(name: str, known: Known) -> None:
    scene, strategy = known.scene, STRATEGIES[name]
    commitments = next(known.each())
    first = commitments.order[0]
    in_hand = grasped(scene, commitments.grasps[first])
    guarded = keep_clear(strategy, commitments, first)
    world = CollisionWorld.from_scene(in_hand)
    placement = next(known.placements.find(world, guarded, strategy, np.random.default_rng(0)))
    assert np.all(np.abs(placement.location - scene.support.position[:2]) < scene.support.half_extents[:2])
    assert world.hits(placement.base, placement.q, placement.opening, held=in_hand.held) == 0
    after = CollisionWorld.from_scene(scene.with_body(placement.body))
    bit = scene.mask([first])
    for grasp in filter(None, (guarded.target, *guarded.obstacles)):
        assert not after.hits(grasp.base, grasp.q, grasp.opening) & bit
