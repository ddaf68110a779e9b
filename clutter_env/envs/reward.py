"""Reward of the retrieval task: differences of a potential, a bonus for success, penalties for disturbing.

The potential of a state says how near the target is to being lifted. Its differences are plain, not discounted, so
their sum over an episode depends on the last state alone: staying anywhere, at any height, earns nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

from clutter_env.envs.success import LIFT_HEIGHT, SuccessMonitor
from clutter_env.simulation.world import Measurements, World

REACH_SCALE = 5.0
"""[1/m] The reaching term falls to a quarter at 0.2 m."""

POTENTIAL_TERMS = ("reach", "grasp", "lift")
"""Terms of the potential, each between 0 and 1; the reward counts their change in a step."""

DENSE_SCALES: Mapping[str, float] = MappingProxyType(
    {"reach": 0.2, "grasp": 0.2, "lift": 0.6, "success": 10.0, "disturbed": -3.0, "lost": -10.0}
)
"""Worth of one unit of each term in the dense reward.

The potential is at most 1 altogether, less than the penalty for one disturbed object: disturbing never pays, however
much sooner the target is lifted, with discounts from 0.95 on."""


def dense_reward(before: float, after: float, events: Mapping[str, float]) -> float:
    """The reward of a step: the difference of two potentials, and the events in between times their scales.

    Args:
        before: `potential` of the state before the step.
        after: `potential` of the state after it.
        events: `event_terms` of the step.
    """
    return after - before + sum(DENSE_SCALES[name] * value for name, value in events.items())


def potential(terms: Mapping[str, float]) -> float:
    """The potential of a state with these `potential_terms`."""
    return sum(DENSE_SCALES[name] * terms[name] for name in POTENTIAL_TERMS)


def potential_terms(world: World, measurements: Measurements, monitor: SuccessMonitor, target: int) -> dict[str, float]:
    """The terms of a state's potential, each between 0 and 1: see the table in `docs/retrieve.md`."""
    assert world.scene is not None
    # From the TCP to the point on the target's axis where a side grasp holds it.
    x, y, z = (float(value) for value in world.data.site_xpos[world.index.tcp_site] - measurements.poses[target, :3])
    distance = math.hypot(x, y, z + float(world.scene.standing_extents[target, 2]) - world.robot.grasp_height)
    is_held = float(monitor.is_target_carried)
    return {
        "reach": 1.0 - math.tanh(REACH_SCALE * distance),
        "grasp": is_held,
        "lift": is_held * min(max(monitor.lift / LIFT_HEIGHT, 0.0), 1.0),
    }


def event_terms(monitor: SuccessMonitor, is_success: bool) -> dict[str, float]:
    """Events of a step: success (0 or 1), objects newly disturbed or fallen, target lost (0 or 1)."""
    return {
        "success": float(is_success),
        "disturbed": float(monitor.newly_disturbed),
        "lost": float(monitor.is_target_lost),
    }
