"""A solved and an unsolvable problem, and laws of plans and episodes, that several test files share."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from assets.robots import FETCH
from planners import Infeasible, Planner, Solution, TampExpert
from planners.motion.mujoco_check import STEP, TOLERANCE, MujocoCollisionChecker
from tests.planners.scenes import cylinder, random_scene, table_scene


@cache
def solved(strategy: str = "lookahead") -> Solution:
    """A plan with at least one clearance."""
    planner = Planner(FETCH, grasps="side")
    scene = random_scene(25, 3)
    target = next(name for name in scene.names if planner.clearance_floor(scene, name).count)
    found = planner.solve(scene, target, strategy, np.random.default_rng(0))
    assert isinstance(found, Solution), found
    return found


@cache
def refused() -> Infeasible:
    """The answer for an object on the floor behind the table."""
    body = cylinder("object_00", 0.0, 0.0).at((0.2, 0.0, 0.08))
    found = Planner(FETCH).solve(table_scene(body), "object_00")
    assert isinstance(found, Infeasible), found
    return found


def assert_free(solution: Solution, step: float = STEP, tolerance: float = TOLERANCE) -> None:
    """MuJoCo finds no penetration in any action of a plan, checked every `step` [m], over a tolerance [m]."""
    checkers: dict[str, MujocoCollisionChecker] = {}
    for action in solution.actions:
        arm = action.scene.robot.arm_name
        if arm not in checkers:
            checkers[arm] = MujocoCollisionChecker(action.scene)
        checkers[arm].move_to(action.scene)
        assert checkers[arm].deepest_penetration(action.trajectory, step).penetration <= tolerance, str(action)


def play(env: Any, expert: TampExpert) -> dict[str, Any]:
    """The environment's info at the end of an episode of the expert."""
    is_over, info = expert.done, {}
    while not is_over:
        _, _, terminated, truncated, info = env.step(expert.act())
        is_over = terminated or truncated or expert.done
    return info
