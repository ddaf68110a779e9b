"""All choices that are as good as a plan's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from assets.robots import FETCH
from planners.clearing.lower_bound import smallest_set
from planners.contact import contact_of
from planners.planner import Planner
from planners.scene import Scene
from planners.skills.alternatives import Alternatives, direction_class
from planners.tamp.solution import Solution
from tests.planners.scenes import random_scene

PLANNER = Planner(FETCH, grasps="side", canonical=True)


def plan_with_clearances(first_seed: int) -> Solution:
    for seed in range(first_seed, first_seed + 20):
        found = PLANNER.solve(random_scene(15, seed), "object_03")
        if isinstance(found, Solution) and found.clearances:
            return found
    raise AssertionError("no scene needs clearing")


@pytest.fixture(scope="module")
def plan() -> Solution:
    return plan_with_clearances(0)


def minimum(alternatives: Alternatives, scene: Scene, target: int) -> int | None:
    def masks(name: str) -> list[int]:
        return [grasp.blockers for grasp in alternatives.grasps.for_object(scene, name)]

    return smallest_set(masks, scene.names[target], scene.names).count


def test_the_plans_own_straight_choices_are_free(plan: Solution) -> None:
    alternatives = Alternatives.of(PLANNER, plan.actions[0].scene)
    for action in plan.actions:
        contact = contact_of(action)
        if contact is None or not contact.is_straight:
            continue
        direction = direction_class(contact.yaw)
        if contact.skill == "pick":
            free = alternatives.free_grasps(action.scene)
            assert free[action.scene.index(contact.object), 0, direction]
        else:
            cells = alternatives.cells(action.scene)
            directions = alternatives.free_cells(action.scene, action.surfaces)
            released = action.released
            assert released is not None
            nearest = np.linalg.norm(cells[:, :2] - released.position[:2], axis=1).argmin()
            assert directions[nearest] == direction


def test_what_is_as_good_lowers_the_minimum_by_one(plan: Solution) -> None:
    """Removing one of these objects from the scene leaves one clearance less, removing another free one does not."""
    scene, left = plan.actions[0].scene, len(plan.clearances)
    alternatives = Alternatives.of(PLANNER, scene)
    free = alternatives.free_grasps(scene)
    as_good = alternatives.as_good(scene, plan.target, free, left)
    before = minimum(alternatives, scene, scene.index(plan.target))
    assert as_good.any()
    assert not (as_good & ~free).any()
    for index in np.flatnonzero(free.any(axis=(1, 2))):
        if scene.names[index] == plan.target:
            continue
        rest = replace(scene, objects=tuple(body for k, body in enumerate(scene.objects) if k != index))
        after = minimum(Alternatives.of(PLANNER, rest), rest, rest.index(plan.target))
        assert before is not None
        assert after is not None
        assert as_good[index].any() == (after < before)


@pytest.mark.parametrize(("degrees", "number"), [(0, 0), (7, 0), (8, 1), (-15, 23), (180, 12), (-180, 12), (359, 0)])
def test_direction_classes_are_the_nearest_multiples_of_15_degrees(degrees: float, number: int) -> None:
    assert direction_class(np.radians(degrees)) == number
