"""Reward of the retrieval task: a bonus for success, penalties for disturbing, and shaping by a potential.

The potential of a state says how near the target is to being lifted: what is still in its way, and the gripper's reach,
grasp and lift. The shaping is γ Φ(after) - Φ(before) with γ = `DISCOUNT` and Φ = 0 once the episode has ended (Ng,
Harada and Russell 1999): it changes no optimal policy, and no cycle of states pays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

from clutter_env.envs.success import LIFT_HEIGHT, SuccessMonitor
from clutter_env.simulation.world import Measurements, World

DISCOUNT = 0.99
"""The discount that the dense reward is made for."""
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


def event_terms(monitor: SuccessMonitor, is_success: bool) -> dict[str, float]:
    """Events of a step: success (0 or 1), objects newly disturbed or fallen, target lost (0 or 1)."""
    return {
        "success": float(is_success),
        "disturbed": float(monitor.newly_disturbed),
        "lost": float(monitor.is_target_lost),
    }
