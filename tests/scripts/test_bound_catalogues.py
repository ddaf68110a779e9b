"""Stored lower bounds that differ from those of today are those of another sample of grasps or base poses."""

from __future__ import annotations

import clutter_env
from clutter_env.suites import SuiteScene
from scripts.bound_catalogues import rows


def scene_of(suite: str, seed: int) -> SuiteScene:
    both = (*clutter_env.suite(suite).test, *clutter_env.suite(suite).validation)
    return next(scene for scene in both if scene.seed == seed)


def test_a_bound_that_rose_has_a_plan_below_it_from_more_base_poses() -> None:
    """So a bound is about the sampled base poses, as its docstring says."""
    ((*_, grasps, there, today, _, with_more, plan, plan_with_more),) = rows(scene_of("deep-25-v2", 2085241))
    assert (grasps, there, today, with_more) == ("side", 3, 4, 3)
    assert (plan, plan_with_more) == (4, 3)


def test_a_bound_that_fell_is_as_stored_without_the_families_that_came_later() -> None:
    ((*_, grasps, there, today, without, _, plan, _),) = rows(scene_of("dense-25-v3", 2065005))
    assert (grasps, there, today, without, plan) == ("all", 1, 0, 1, 0)
