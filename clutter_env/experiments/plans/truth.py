"""Whole plans under MuJoCo's eyes: every action of a solution, judged in the scene that the actions before it leave."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planners.collision.world import STEP
from planners.motion.arm import tcp_pose
from planners.motion.mujoco_check import MujocoCollisionChecker
from planners.planner import Planner
from planners.scene import RobotState, Scene
from planners.tamp.solution import BoundAction, Infeasible, Solution

__all__ = ["Judged", "judge_plan", "scenes_along"]

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
    for before, action in scenes_along(scene, found):
        checker.move_to(before)
        report = checker.deepest_penetration(action.trajectory, STEP / FINER)
        if report.penetration > worst.penetration:
            worst = Judged(report.penetration, str(action), report.pair, len(found.actions))
    return worst


def scenes_along(scene: Scene, solution: Solution) -> Iterator[tuple[Scene, BoundAction]]:
    """Each action, and the scene it starts from."""
    for action in solution.actions:
        yield scene, action
        scene = _after(scene, action)


def _after(scene: Scene, action: BoundAction) -> Scene:
    """The scene that an action leaves: the robot at its end, what it let go of where it let go."""
    way = action.trajectory
    end = RobotState(way.base[-1], way.q[-1], float(way.finger_position[-1]))
    last = way.phases[-1]
    if last.held:
        return scene.with_state(end).with_held(last.touched)
    release = next((phase for phase in way.phases if phase.name == "open"), None)
    if release is None or release.touched is None:
        return scene.with_state(end)
    sample = way.sample(release.start)
    hand = tcp_pose(scene.robot, RobotState(sample.base, sample.q, 0.0))
    placed = scene.body(release.touched.name).at_pose(hand @ release.touched.T_tcp_object)
    return scene.with_state(end).with_held(None).with_body(placed)
