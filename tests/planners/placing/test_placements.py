"""Which locations are tried for an object in hand, how many, and in which order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from planners.clearing.lookahead import grasped
from planners.collision.world import CollisionWorld
from planners.grasping.candidates import GraspCandidates
from planners.placing import placements
from planners.placing.locations import placement_levels
from planners.placing.placements import Placement, PlacementSearch
from planners.planner import map_placer
from planners.scene import Scene
from planners.strategies import STRATEGIES, Strategy, StrategyError
from tests.planners.motion_scenes import CHAIN
from tests.planners.scenes import cylinder, table_scene

CHOICES = ("name", "grasps", "region", "locations")
PLANNING_AHEAD = ("plans_ahead", "sets", "slack", "variations")


@pytest.fixture(scope="module")
def in_hand() -> Scene:
    """One of two objects of a nearly empty table, grasped."""
    scene = table_scene(cylinder("object_00", -0.2, 0.1), cylinder("object_01", 0.0, -0.3))
    return grasped(scene, GraspCandidates(map_placer(scene), CHAIN).for_object(scene, "object_00")[0])


def search(scene: Scene) -> PlacementSearch:
    return PlacementSearch(map_placer(scene), CHAIN)


def locations_tried(
    scene: Scene, strategy: Strategy, monkeypatch: pytest.MonkeyPatch
) -> dict[str, list[NDArray[np.float64]]]:
    """The locations at which each part of the search looks, level by level, if it never finds anything."""
    tried: dict[str, list[list[NDArray[np.float64]]]] = {"_from_here": [], "_after_a_drive": []}
    last = ""

    def recorder(name: str) -> Any:
        def record(
            _search: PlacementSearch, _world: CollisionWorld, location: NDArray[np.float64]
        ) -> Iterator[Placement]:
            nonlocal last
            if last != name or not tried[name]:
                tried[name].append([])
            last = name
            tried[name][-1].append(location)
            return iter(())

        return record

    for name in tried:
        monkeypatch.setattr(PlacementSearch, name, recorder(name))
    world = CollisionWorld.from_scene(scene)
    assert next(search(scene).find(world, [], strategy, np.random.default_rng(0)), None) is None
    return {name: [np.array(level) for level in levels] for name, levels in tried.items()}


def test_strategies_differ_in_three_choices_and_in_planning_ahead() -> None:
    budget = [field.name for field in fields(Strategy) if field.name not in (*CHOICES, *PLANNING_AHEAD)]
    assert {"attempts", "locations_per_level", "placements", "leaves_cleared"} <= set(budget)
    assert len({tuple(getattr(strategy, name) for name in budget) for strategy in STRATEGIES.values()}) == 1
    greedy = [strategy for strategy in STRATEGIES.values() if not strategy.plans_ahead]
    assert len({tuple(getattr(strategy, name) for name in PLANNING_AHEAD) for strategy in greedy}) == 1


def test_every_strategy_tries_as_many_locations(in_hand: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a base motion all of them, from where the base stands those within reach."""
    counts = {}
    for name, strategy in STRATEGIES.items():
        tried = locations_tried(in_hand, strategy, monkeypatch)
        counts[name] = sum(map(len, tried["_after_a_drive"]))
        assert 0.9 * counts[name] < sum(map(len, tried["_from_here"])) <= counts[name]
    assert len(set(counts.values())) == 1, counts


@pytest.mark.parametrize(("field", "value"), [("attempts", 0), ("sets", 1.5), ("slack", -1), ("placements", None)])
def test_a_budget_that_is_none_is_refused(field: str, value: Any) -> None:
    with pytest.raises(StrategyError, match=f"{field}=.*integer of at least"):
        replace(STRATEGIES["ngr"], **{field: value})


def test_levels_grow_finer(in_hand: Scene) -> None:
    sizes = [len(level) for level in placement_levels(in_hand.support, np.random.default_rng(0))]
    assert sizes == [25, 81, 289, 1089]


def test_farthest_within_reach_first_however_many_locations_there_are(
    in_hand: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = locations_tried(in_hand, replace(STRATEGIES["ngr"], locations_per_level=5), monkeypatch)
    every = locations_tried(in_hand, replace(STRATEGIES["ngr"], locations_per_level=10_000), monkeypatch)
    here = in_hand.state.base[:2]
    for some, of_all in zip(tried["_from_here"], every["_from_here"], strict=True):
        distances = np.linalg.norm(some - here, axis=1)
        assert np.array_equal(some, of_all[:5])
        assert distances[0] == np.linalg.norm(of_all - here, axis=1).max()
        assert (np.diff(distances) <= 0).all()
    for some, of_all in zip(tried["_after_a_drive"], every["_after_a_drive"], strict=True):
        assert np.array_equal(some, of_all[:5])
        assert (np.diff(np.linalg.norm(of_all - here, axis=1)) >= 0).all()


def test_no_location_that_the_arm_can_serve_counts_as_out_of_reach(
    in_hand: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    finder, world = search(in_hand), CollisionWorld.from_scene(in_hand)
    locations = list(placement_levels(in_hand.support, np.random.default_rng(0)))[2]
    assert not finder._is_within_reach(in_hand, locations).all()
    with monkeypatch.context() as patch:
        patch.setattr(placements, "_can_reach", lambda _scene, _base, poses: np.ones(len(poses), dtype=bool))
        placements_there = [placement for place in locations for placement in finder._from_here(world, place)]
    served = np.array([placement.location for placement in placements_there])
    assert len(served) > 50
    assert finder._is_within_reach(in_hand, served).all()
