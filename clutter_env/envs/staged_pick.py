"""Staged reward of ArmPick: between 0 and 1 a step, 1 where the object is held at its goal.

A step earns r = Σ w_i t_i < 1, with terms t_i of the state between 0 and 1: `reach` (how near the gripper is to the
grasp), `around` (how far the object is between the fingers), `grasp` (how far they have closed on it, 1 if it is held),
and `goal`: how near a held object is to its goal. Held at the goal a step earns 1, and the episode goes on.

An object that is at its goal without being held earns nothing for it. Otherwise the episodes that begin there, 6
of 100, would earn 1 a step whatever the hand does. A critic then tells values by the distance of object and goal, which
are 20 compared with 0.5, and not by the hand. The measurements are in docs/notes/learning.md.

Finishing beats hovering, for every discount γ < 1, if the time limit is truncation. Hovering at a level h < 1 for ever
earns h / (1 - γ). k steps of at least h, and holding the object at the goal from then on, earn at least (h (1 - γ^k) +
γ^k) / (1 - γ), which is more, for every k.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

from clutter_env.envs.from_above import Nearness

PICK_WEIGHTS: Mapping[str, float] = MappingProxyType({"reach": 0.1, "around": 0.05, "grasp": 0.25, "goal": 0.6})
"""Weights of the terms."""
CLOSING = 0.75
"""Share of the grasping term that fingers earn which have closed on the object and do not hold it yet."""
GOAL_SCALE = 5.0
"""[1/m] The term of the goal falls to a half at 0.11 m."""


def pick_terms(nearness: Nearness, is_held: bool, distance: float) -> dict[str, float]:
    """The weighted terms of a state, by their names. Their sum is less than 1 away from the goal.

    Args:
        nearness: of the gripper to the grasp of the object.
        is_held: whether the object is held.
        distance: [m] of the object from its goal.
    """
    hand = Nearness(1.0, 1.0, 1.0) if is_held else nearness._replace(closed=CLOSING * nearness.closed)
    values = (*hand, is_held * (1.0 - math.tanh(GOAL_SCALE * distance)))
    return {name: weight * value for (name, weight), value in zip(PICK_WEIGHTS.items(), values, strict=True)}


def pick_reward(terms: Mapping[str, float], distance: float, tolerance: float) -> float:
    """The reward of a state with these terms at another distance from a goal, such as a relabelled one.

    Args:
        terms: from `pick_terms`, of whose goal nothing is used.
        distance: [m] of the object from the goal.
        tolerance: [m] within which the goal is reached.
    """
    is_held = terms["grasp"] >= PICK_WEIGHTS["grasp"]
    if is_held and distance <= tolerance:
        return 1.0
    goal = PICK_WEIGHTS["goal"] * is_held * (1.0 - math.tanh(GOAL_SCALE * distance))
    return math.fsum((terms["reach"], terms["around"], terms["grasp"], goal))
