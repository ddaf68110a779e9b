"""Reward of the retrieval task: a bonus for success, penalties for disturbing, and shaping by a potential.

The potential of a state says how near the target is to being lifted: what is still in its way, and the gripper's reach,
grasp and lift. The shaping is γ Φ(after) - Φ(before) with γ = `DISCOUNT` and Φ = 0 once the episode has ended (Ng,
Harada and Russell 1999): it changes no optimal policy, and no cycle of states pays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from clutter_env.envs.success import LIFT_HEIGHT, SuccessMonitor
from clutter_env.scene.layout import Layout
from clutter_env.scene.obstruction import UNREACHABLE, count_blockers, robots_with_approaches, side_approaches
from clutter_env.simulation.world import Measurements, World

DISCOUNT = 0.99
"""The discount that the dense reward is made for."""
_FAR_AWAY = 100.0
"""[m]"""
REACH_SCALE = 5.0
"""[1/m] The reaching term falls to a quarter at 0.2 m."""

POTENTIAL_SCALES: Mapping[str, float] = MappingProxyType({"way": 0.25, "reach": 0.05, "grasp": 0.05, "lift": 0.15})
"""Worth of each term of the potential, each between 0 and 1.

Together at most a half: with a discount of 1, shaping costs at most 0.005 in a step, so that an episode of 1900 steps
that ends in success still earns more than any that does not."""
EVENT_SCALES: Mapping[str, float] = MappingProxyType({"success": 10.0, "disturbed": -3.0, "lost": -10.0})
"""Worth of the events of a step."""


def dense_reward(before: float, after: float, events: Mapping[str, float]) -> float:
    """The reward of a step: shaping, and the events in between times their scales.

    Args:
        before: `potential` of the state before the step.
        after: `potential` of the state after it, 0 if the episode has ended.
        events: `event_terms` of the step.
    """
    return DISCOUNT * after - before + sum(EVENT_SCALES[name] * value for name, value in events.items())


def potential(terms: Mapping[str, float]) -> float:
    """The potential of a state with these `potential_terms`."""
    return sum(scale * terms[name] for name, scale in POTENTIAL_SCALES.items())


def potential_terms(
    world: World, measurements: Measurements, monitor: SuccessMonitor, target: int, in_the_way: int
) -> dict[str, float]:
    """The terms of a state's potential, each between 0 and 1: see the table in `docs/retrieve.md`.

    Args:
        world: the world, its kinematics settled.
        measurements: its measurements.
        monitor: its success monitor.
        target: the target's slot.
        in_the_way: number of objects in the way of the best side grasp of the target.
    """
    assert world.scene is not None
    # From the TCP to the point on the target's axis where a side grasp holds it.
    x, y, z = (float(value) for value in world.data.site_xpos[world.index.tcp_site] - measurements.poses[target, :3])
    distance = math.hypot(x, y, z + float(world.scene.standing_extents[target, 2]) - world.robot.grasp_height)
    is_held = float(target in measurements.grip.held)
    is_carried = float(monitor.is_target_carried)
    return {
        "way": 1.0 / (1 + in_the_way),
        "reach": 1.0 - math.tanh(REACH_SCALE * distance),
        "grasp": is_held,
        "lift": is_carried * min(max(monitor.lift / LIFT_HEIGHT, 0.0), 1.0),
    }


class Way:
    """Counts the objects in the way of the best side grasp of the target, by the geometric test of resets.

    None are once the target is held, and for a robot without a table of side approaches. What is held, has toppled or
    is off the table is in nobody's way. Poses are rounded to 0.1 mm and 0.1 mrad, and counted again only when
    one of them has changed.
    """

    def __init__(self) -> None:
        self._last, self._count = (b"", -1), 0

    def count(self, world: World, layout: Layout, measurements: Measurements, target: int) -> int:
        """The number in the present state."""
        scene, robot, held = world.scene, world.robot.full_name, measurements.grip.held
        assert scene is not None
        if target in held or robot not in robots_with_approaches():
            return 0
        is_away = measurements.is_fallen.copy()
        is_away[[slot for slot in held if slot >= 0]] = True
        turns = 2 * np.arctan2(measurements.poses[:, 6], measurements.poses[:, 3])
        rounded = np.round(np.column_stack((measurements.poses[:, :2], turns)), 4)
        rounded[is_away] = _FAR_AWAY
        state = rounded.tobytes(), id(scene)
        if state != self._last:
            yaws = np.where(scene.is_lying, scene.yaws, rounded[:, 2])
            now = replace(scene, positions=rounded[:, :2], yaws=yaws)
            blockers = count_blockers(side_approaches(robot), layout, now, world.robot.max_opening, only=target)
            self._count = scene.num_objects if blockers[target] == UNREACHABLE else int(blockers[target])
            self._last = state
        return self._count


def event_terms(monitor: SuccessMonitor, is_success: bool) -> dict[str, float]:
    """Events of a step: success (0 or 1), objects newly disturbed or fallen, target lost (0 or 1)."""
    return {
        "success": float(is_success),
        "disturbed": float(monitor.newly_disturbed),
        "lost": float(monitor.is_target_lost),
    }
