"""Whole plans under MuJoCo's eyes: every action of a solution, judged in the scene that the actions before it leave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.collision.world import STEP
from planners.motion.mujoco_check import MujocoCollisionChecker
from planners.planner import Planner
from planners.scene import Scene
from planners.tamp.solution import Infeasible

__all__ = ["Judged", "judge_plan"]

FINER = 10
"""How many times finer than the planner the judge looks."""


@dataclass(frozen=True)
class Judged:
    """A plan's deepest penetration [m], the action and the pair of geoms it is met in, and the number of actions."""

    penetration: float = 0.0
    action: str = ""
    pair: tuple[str, str] = ("", "")
    actions: int = 0


def judge_plan(scene: Scene, target: str, seed: int) -> Judged | Infeasible:
    """Solve, and judge what was found."""
    found = Planner(scene.robot).solve(scene, target, rng=np.random.default_rng(seed))
    if isinstance(found, Infeasible):
        return found
    checker, worst = MujocoCollisionChecker(scene), Judged(actions=len(found.actions))
    for action in found.actions:
        checker.move_to(action.scene)
        report = checker.deepest_penetration(action.trajectory, STEP / FINER)
        if report.penetration > worst.penetration:
            worst = Judged(report.penetration, str(action), report.pair, len(found.actions))
    return worst
