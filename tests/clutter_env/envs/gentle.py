"""Honest and gentle ways to lift the target, in "ee" mode: each deserves a clean success."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from clutter_env.scene.layout import TABLE_HEIGHT
from tests.clutter_env.envs.cheats import HEIGHT, OTHER, RADIUS, TARGET, TIP, Cheat, cylinder
from tests.clutter_env.envs.side_grasp import CLOSED, OPEN, PRE_GRASP

BESIDE = (-0.18, -0.12)
"""[m] where the target stands."""


@dataclass(frozen=True)
class Gentle:
    """A behaviour: its script, and the objects, the target first."""

    script: Callable[[Cheat], dict]
    objects: Sequence[dict]


def lift(robot: Cheat) -> dict:
    """Lift what is held; the info of the end."""
    robot.reach(robot.point + (0, 0, 0.16))
    robot.wait(1.0)
    return robot.info


def soft_grip(robot: Cheat) -> dict:
    """The fingers close by half a millimetre beyond the target's width."""
    robot.grasp(TARGET, 2 * RADIUS - 0.0005)
    return lift(robot)


def softer_grip_of_more(robot: Cheat) -> dict:
    """They close by 1.1 mm beyond it: friction carries 1.8 N, and the target weighs 1.5 N."""
    robot.grasp(TARGET, 2 * RADIUS - 0.0011)
    return lift(robot)


def brush(robot: Cheat) -> dict:
    """The target is lifted along a heavy neighbour, whose side it touches on the way."""
    robot.grasp(TARGET)
    robot.reach(robot.point + (0.004, 0, 0.0), speed=0.02)
    return lift(robot)


def touch_with_fingertips(robot: Cheat) -> dict:
    """The closed fingers touch the table at 0.12 m/s and are withdrawn at once; then the target is lifted."""
    robot.before(robot.at(TARGET) + (0, 0.12, 0))
    robot.grip(CLOSED)
    robot.reach(robot.point + (PRE_GRASP, 0, 0.06 - robot.point[2] + TABLE_HEIGHT))
    while not robot.env.data.ncon and robot.point[2] > TABLE_HEIGHT - 0.02:
        robot.point = robot.point - (0, 0, 0.006)
        robot.step()
    robot.reach(robot.point + (0, 0, 0.2))
    robot.grip(OPEN)
    return robot.take_target()


def slide_along(robot: Cheat) -> dict:
    """The target, held just above the table, slides along its neighbour's side before it is lifted."""
    robot.grasp(TARGET)
    robot.reach(robot.point + (0, 0, 0.01))
    robot.reach(robot.point + (-0.04, 0, 0), speed=0.05)
    return lift(robot)


def put_aside_slowly(robot: Cheat) -> dict:
    """The neighbour is carried 12 cm and set down slowly; then the target is lifted."""
    robot.grasp(OTHER)
    robot.reach(robot.point + (0, 0, 0.05))
    robot.reach(robot.point + (0, 0.12, 0))
    robot.reach(robot.point - (0, 0, 0.05), speed=0.03)
    robot.leave()
    return robot.take_target()


def regrasp(robot: Cheat) -> dict:
    """The target is lifted by 2 cm, set down, and taken again a little higher."""
    robot.grasp(TARGET)
    robot.reach(robot.point + (0, 0, 0.02))
    robot.reach(robot.point - (0, 0, 0.02), speed=0.05)
    robot.grip(OPEN)
    robot.reach(robot.point + (0, 0, 0.015))
    robot.grip(CLOSED)
    return lift(robot)


def rest_on_the_table(robot: Cheat) -> dict:
    """The closed fingers rest on the table for a second, as heavy as a cup; then the target is lifted."""
    robot.before(robot.at(TARGET) + (0, 0.12, 0))
    robot.grip(CLOSED)
    robot.reach(robot.point + (PRE_GRASP, 0, 0.06 - robot.point[2] + TABLE_HEIGHT))
    while robot.info["furniture_force"] < 3.0 and robot.point[2] > TABLE_HEIGHT - 0.05:
        robot.point = robot.point - (0, 0, 0.0005)
        robot.step()
    robot.wait(1.0)
    robot.reach(robot.point + (0, 0, 0.2))
    robot.grip(OPEN)
    return robot.take_target()


def nudge(robot: Cheat) -> dict:
    """The neighbour is pushed by a centimetre; then the target is lifted."""
    there = robot.at(OTHER, 0.055)
    robot.before(there)
    robot.grip(CLOSED)
    robot.reach(there + (0.01 - TIP - RADIUS, 0.0, 0.0), speed=0.03)
    robot.leave()
    return robot.take_target()


def _target(**more: float) -> dict:
    return {**cylinder(*BESIDE), **more}


_AWAY = cylinder(-0.24, 0.2)
_CLOSE = {**cylinder(BESIDE[0] + 2 * RADIUS + 0.003, BESIDE[1]), "mass": 0.8}
_CLOSE_BEHIND = {**cylinder(BESIDE[0] + 2 * RADIUS + 0.0005, BESIDE[1]), "mass": 0.8}
_BOX = {"shape": "box", "depth": 0.05, "width": 0.05, "height": HEIGHT, "position": BESIDE}

GENTLE: dict[str, Gentle] = {
    "soft grip of 50 g": Gentle(soft_grip, (_target(mass=0.05), _AWAY)),
    "soft grip of 150 g": Gentle(softer_grip_of_more, (_target(mass=0.15), _AWAY)),
    "brushing a heavy neighbour": Gentle(brush, (_target(), _CLOSE)),
    "touching the table with fingertips": Gentle(touch_with_fingertips, (_target(), _AWAY)),
    "sliding along a neighbour": Gentle(slide_along, (_target(), _CLOSE_BEHIND)),
    "slow set-down": Gentle(put_aside_slowly, (_target(), _AWAY)),
    "regrasp": Gentle(regrasp, (_target(), _AWAY)),
    "light object": Gentle(Cheat.take_target, (_target(mass=0.02), _AWAY)),
    "heavy object": Gentle(Cheat.take_target, (_target(mass=2.0), _AWAY)),
    "tall object": Gentle(Cheat.take_target, (_target(height=0.24), _AWAY)),
    "box": Gentle(Cheat.take_target, (_BOX, _AWAY)),
    "closed fingers resting on the table": Gentle(rest_on_the_table, (_target(), _AWAY)),
    "nudging a neighbour by a centimetre": Gentle(nudge, (_target(), _AWAY)),
}
"""Behaviours by their names."""
