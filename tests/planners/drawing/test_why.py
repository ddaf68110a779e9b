"""What the page says about refused grasps and places: laws that the planner's bound and plans obey."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

from assets.robots import FETCH
from planners import Planner, Scene
from planners.drawing.choices import choices_of
from planners.drawing.page.content import page_text
from planners.drawing.page.page import plan_recording
from planners.drawing.why import why_grasps, why_places
from planners.expert.report import Recording, Solve
from planners.grasping.families import find_grasp_set
from tests.planners.drawing.test_page import Content
from tests.planners.plans import refused, solved
from tests.planners.scenes import cylinder, random_scene, table_scene


@pytest.fixture(scope="module")
def recording() -> Recording:
    return plan_recording(solved())


def why_of(recording: Recording) -> dict[str, Any]:
    content = Content(page_text(recording, "title", {}, "plan"))
    found: dict[str, Any] = json.loads(bytes(content.array(content.values["solves"][0]["why"])))
    return found


@pytest.mark.parametrize(("count", "seed", "grasps"), [(15, 1, "side"), (25, 3, "all")])
def test_the_cheapest_way_to_an_object_is_the_proved_minimum(count: int, seed: int, grasps: str) -> None:
    scene, planner = random_scene(count, seed), Planner(FETCH, grasps=grasps)
    for answer in why_grasps(scene, find_grasp_set(grasps)):
        costs = [way.moves for way in answer.ways if way.moves is not None]
        assert min(costs, default=None) == planner.clearance_floor(scene, answer.name).count, answer.name
        assert costs == sorted(costs)
        for way in answer.ways:
            assert way.moves is None or (len(way.first) == way.moves and {*way.blockers} <= {*way.first})


def test_a_grasp_is_free_without_the_objects_that_are_named() -> None:
    families = find_grasp_set("side")
    scene = random_scene(15, 1)
    blocked = 0
    for answer in why_grasps(scene, families)[:6]:
        for index, one in enumerate(answer.grasps):
            if one.blockers and index % 4 == 0:
                blocked += 1
                named = {blocker.name for blocker in one.blockers}
                alone = dataclasses.replace(scene, objects=tuple(b for b in scene.objects if b.name not in named))
                there = next(
                    other for other in why_grasps(only(alone, answer.name), families) if other.name == answer.name
                )
                assert there.grasps[index].grasp is not None
                free = next(other for other in why_grasps(alone, families) if other.name == answer.name)
                assert free.grasps[index].blockers == ()
    assert blocked > 2


def only(scene: Scene, name: str) -> Scene:
    return dataclasses.replace(scene, objects=(scene.body(name),))


def test_what_stands_on_an_object_and_furniture_are_named() -> None:
    low = cylinder("low", 0.0, 0.0, height=0.1)
    high = cylinder("high", 0.0, 0.0).at(low.position + [0.0, 0.0, 0.13])
    answers = {one.name: one for one in why_grasps(table_scene(low, high), find_grasp_set("side"))}
    parts = {(blocker.name, blocker.part) for one in answers["low"].grasps for blocker in one.blockers}
    assert parts == {("high", "on it")}
    assert [way.moves for way in answers["low"].ways] == [1]
    below = why_grasps(table_scene(cylinder("floor_one", 0.2, 0.0).at((0.2, 0.0, 0.08))), find_grasp_set("side"))
    assert all(one.grasp is None for one in below[0].grasps)


def test_the_grasps_of_a_plan_are_marked_with_what_was_put_aside_before() -> None:
    plan = solved()
    answers = {one.name: one for one in why_grasps(plan.actions[0].scene, plan.grasps, plan)}
    aside: set[str] = set()
    for action in plan.actions:
        if action.name == "PickUp":
            taken = answers[action.target].taken
            assert taken is not None
            assert {blocker.name for blocker in answers[action.target].grasps[taken].blockers} <= aside
            aside.add(action.target)
    assert plan.target in aside
    assert any(one.taken is None for one in answers.values())


def test_every_refused_place_has_a_reason_and_no_allowed_one() -> None:
    for choice, places in zip(choices_of(solved()), why_places(solved()), strict=True):
        allowed = {tuple(place) for place in choice.ordered}
        for place, answer in zip(choice.candidates, places, strict=True):
            is_refused = bool(answer.standing or answer.furniture or answer.off or answer.ways)
            assert is_refused == (tuple(place) not in allowed)
            assert choice.moved not in (*answer.standing, *answer.ways)
            for name in answer.standing:
                other = next(body for body in choice.bodies if body.name == name)
                assert np.hypot(*(other.position[:2] - place)) < 0.2


def test_the_page_has_a_row_for_each_grasp_and_stays_small(recording: Recording) -> None:
    why = why_of(recording)
    assert why["grasps"] == "'side'"
    assert {one["name"] for one in why["objects"]} == set(solved().actions[0].scene.names)
    for one in why["objects"]:
        assert {grasp[5] for grasp in one["grasps"]} == set(range(len(one["rows"])))
    target = next(one for one in why["objects"] if one["name"] == solved().target)
    row = target["rows"][target["grasps"][target["taken"]][5]]
    assert row["state"] == "blocked"
    assert row["moves"] == len(solved().clearances)
    bare = dataclasses.replace(recording, solves=(recording.solves[0]._replace(grasps=()),))
    sizes = [len(page_text(one, "title", {}, "plan")) for one in (bare, recording)]
    assert sizes[1] < 1.1 * sizes[0]


def test_a_refusal_is_explained_too(recording: Recording) -> None:
    """As long as its scene is known."""
    body = cylinder("object_00", 0.0, 0.0).at((0.2, 0.0, 0.08))
    solve = Solve(0.0, refused(), table_scene(body), find_grasp_set("side"))
    (one,) = why_of(dataclasses.replace(recording, solves=(solve,)))["objects"]
    assert {row["state"] for row in one["rows"]} <= {"furniture", "unreached"}
    assert one["taken"] == -1
