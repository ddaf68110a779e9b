"""Planning ahead: the moves that are meant to be made, and what is kept clear for them."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest

from planners import STRATEGIES, Goal, goals, solve
from planners.clearing.goal_bound import LowerBound
from planners.clearing.lookahead import _in_turn, _Search, _Situation
from planners.clearing.moves import Move, MoveMaker
from planners.placing.placements import PlacementSearch
from planners.placing.surfaces import KeepClear
from planners.scene import Scene
from planners.scene.bodies import release_pitch
from planners.tamp.solution import Solution
from planners.workspace import Workspace
from tests.planners.pieces import mug
from tests.planners.scenes import HEIGHT, cylinder, random_scene, table_scene


def maker(scene: Scene, goal: Goal) -> MoveMaker:
    workspace = Workspace.of(scene.robot, scene)
    rng = np.random.default_rng(0)
    return MoveMaker(goal, scene, STRATEGIES["lookahead"], workspace.grasps(), workspace.placements(), rng)


def test_what_waits_for_each_other_is_moved_all_the_same() -> None:
    """Each of two objects was found in the way of the place of the other one, where a third one stands."""
    scene = table_scene(cylinder("a", -0.25, 0.2), cylinder("b", -0.25, -0.2), cylinder("c", 0.1, 0.0))
    goal = goals.at("a", (0.1, 0.01), 0.001) & goals.at("b", (0.1, -0.01), 0.001)
    later = frozenset({("a", "b"), ("b", "a"), ("a", "c"), ("b", "c")})
    bound = LowerBound(5, ("a", "b", "c"), ("a", "b"), True, 5)
    steps = list(_in_turn(maker(scene, goal), scene, bound, ("a", "b"), later))
    assert [(step.name, step.is_general) for step in steps[:3]] == [("a", False), ("b", False), ("c", False)]
    assert sorted((step.name, step.is_general) for step in steps[3:]) == [("a", True), ("b", True)]


@pytest.mark.parametrize(("region", "keeps"), [("ngr", True), ("ngr1", False)])
def test_a_strategy_with_ngr1_keeps_the_target_s_grasp_alone_clear(region: str, keeps: bool) -> None:
    scene = random_scene(25, 0)
    kept: list[tuple[bool, int]] = []
    find = PlacementSearch.find

    def recorded(self: PlacementSearch, world: object, keep_clear: object, *args: object, **more: object) -> object:
        kept.append((keep_clear.target is not None, len(keep_clear.obstacles)))  # type: ignore[attr-defined]  # KeepClear
        return find(self, world, keep_clear, *args, **more)  # type: ignore[arg-type]  # passed on

    strategy = replace(STRATEGIES["lookahead"], region=region)
    with patch.object(PlacementSearch, "find", recorded):
        plans = (solve(scene, name, strategy, grasps="side") for name in scene.names)
        next(plan for plan in plans if isinstance(plan, Solution) and len(plan.clearances) > 1)
    assert any(has_target for has_target, _ in kept)
    assert any(count for _, count in kept) == keeps


@pytest.mark.parametrize(("moves", "expected"), [((True, False), {"a"}), ((False, True), set()), ((False,), {"a"})])
def test_an_object_is_aside_if_its_last_move_put_it_there(moves: tuple[bool, ...], expected: set[str]) -> None:
    """One that was at its place before was put aside over and over, until the tries were used up."""
    scene = table_scene(cylinder("a", -0.2, 0.0))
    made = tuple(Move("a", None, None, is_general, scene) for is_general in moves)
    assert _Situation(scene, made, (), 0).put_aside == expected


def test_nothing_goes_to_its_place_on_what_is_still_to_be_moved() -> None:
    """It would have to leave again."""
    scene = table_scene(cylinder("a", -0.2, -0.2, height=0.06), cylinder("b", -0.2, 0.2, height=0.06))
    search = _Search(maker(scene, goals.on("a", "b") & goals.at("b", (-0.1, 0.0))), scene)
    first = search.situation(scene)
    assert isinstance(first, _Situation)
    assert {step.name for step in search._ready(first)} == {"a", "b"}
    tried = [one for _, tries in search.levels(first, strictly=False)[:2] for one in tries if one is not None]
    assert tried
    assert all(one.moves[0].name == "b" for one in tried)


@pytest.mark.parametrize("shape", ["pieces", "cylinder"])
def test_an_object_of_pieces_is_tried_at_a_pose_with_other_sides_in_the_hand(shape: str) -> None:
    """One grasp of each pitch was tried: a bowl in a cabinet whose rim was held at the wall was refused its place."""
    body = mug("a", (-0.2, 0.0, HEIGHT)) if shape == "pieces" else cylinder("a", -0.2, 0.0)
    scene = table_scene(body)
    moves, tried = maker(scene, goals.at("a", (-0.1, 0.2))), list[float]()

    def refuse(_: MoveMaker, held: Scene, *__: object) -> object:
        assert held.held is not None
        tried.append(round(release_pitch(held.body("a"), held.held), 2))
        return iter(())

    with patch.object(MoveMaker, "places", refuse):
        assert moves.put(scene, "a", True, [KeepClear()], ()) is None
    assert (len(tried) > len(set(tried))) == (shape == "pieces")
