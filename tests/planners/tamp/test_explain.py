"""A refusal names what would have to change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planners.cause import Cause
from planners.planner import solve
from planners.scene import HeldObject
from planners.tamp.solution import Infeasible
from tests.planners.clearing.test_non_monotone import crowded


def test_supports_that_were_not_looked_at_are_named() -> None:
    """With side grasps objects are put on the table alone, as in the paper; the counters beside it are empty."""
    scene = replace(crowded(4, 11), supports=("table_top", "left", "right"))
    wide = replace(scene.body("object_00"), half_extents=np.array([0.15, 0.15, 0.08]))
    holding = scene.with_body(wide).with_held(HeldObject("object_00", np.eye(4)))
    refusal = solve(holding, "object_05", grasps="side")
    assert isinstance(refusal, Infeasible)
    assert refusal.cause is Cause.NO_CLEARANCE_LOCATION
    assert "no location on table_top for object_00" in refusal.detail
    assert "not looked at, since not among the supports chosen: left, right" in refusal.detail
