"""A refusal says why motion planning refuted what was tried."""

from __future__ import annotations

import numpy as np

from assets.robots import FETCH
from planners import Infeasible, Planner
from planners.cause import Cause
from tests.planners.scenes import cylinder, table_scene

SCENE = table_scene(cylinder("wanted", -0.2, 0.0))


class StuckFollower:
    """A model of a controller whose arm does not move."""

    def __init__(self) -> None:
        self._q = np.array(FETCH.home)

    def reset(self, q: np.ndarray) -> None:
        self._q = q

    def step(self, T_base_tcp: np.ndarray) -> np.ndarray:  # noqa: ARG002  it ignores what it is told
        return self._q


def test_a_robot_that_cannot_follow_any_motion_is_told_so() -> None:
    found = Planner(FETCH, follower=StuckFollower(), grasps="side").solve(SCENE, "wanted")
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.MOTION
    assert "the TCP cannot follow the trajectory" in found.detail
