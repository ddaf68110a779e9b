"""Whole plans checked by MuJoCo: each action of a solution in the scene that the actions before it leave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.collision.world import STEP
from planners.motion.mujoco_check import MujocoCollisionChecker
from planners.planner import Planner
from planners.scene import Scene
from planners.tamp.solution import Infeasible

__all__ = ["CheckedPlan", "check_plan"]

FINER = 10
"""How many times smaller the steps of this check are than those of the planner."""


@dataclass(frozen=True)
class CheckedPlan:
    """The deepest penetration of a plan.

    Attributes:
        penetration: its depth [m].
        action: the action in which it happens.
        pair: names of the two geoms.
        actions: number of actions of the plan.
    """

    penetration: float = 0.0
    action: str = ""
    pair: tuple[str, str] = ("", "")
    actions: int = 0


def check_plan(scene: Scene, target: str, seed: int, grasps: str = "side") -> CheckedPlan | Infeasible:
    """Solve with a grasp set, and check the plan that was found; a scene without a plan gives the `Infeasible`."""
    found = Planner(scene.robot, grasps=grasps).solve(scene, target, rng=np.random.default_rng(seed))
    if isinstance(found, Infeasible):
        return found
    checker, worst = MujocoCollisionChecker(scene), CheckedPlan(actions=len(found.actions))
    for action in found.actions:
        checker.move_to(action.scene)
        report = checker.deepest_penetration(action.trajectory, STEP / FINER)
        if report.penetration > worst.penetration:
            worst = CheckedPlan(report.penetration, str(action), report.pair, len(found.actions))
    return worst
