"""Staged reward of the retrieval tasks: between 0 and 1 a step, and at success what staying there would have earned.

A step earns r = Σ w_i t_i <= 1, with terms t_i of the state between 0 and 1: `way` (how far the way to the target is
cleared), `reach` (how near the gripper is to the grasp), `around` (how far the target is between the open fingers),
`grasp`, `lift`, `hold`. All but the first are 0 until the way is free, the last two until the target is held: r rises
along the task. The step of success earns `SUCCESS` = 1 / (1 - Γ), Γ = `DISCOUNT`, and ends the episode.

Finishing beats hovering, for every discount γ <= Γ, the time limit being truncation (the learner goes on with its
estimate there):

- Hovering at a level h < 1 for ever earns h / (1 - γ). Success in step k + 1, after k steps that earn at least h each,
  earns at least h (1 - γ^k) / (1 - γ) + γ^k / (1 - Γ). Since 1 / (1 - Γ) >= 1 / (1 - γ) > h / (1 - γ), that is more,
  for every k: as the reward rises along the task, whoever hovers anywhere on it gains by going on.
- Whatever is done without success earns at most 1 / (1 - γ), from any state, and success no less in one step: where it
  can be had at once, nothing is better.
- A way on which the reward falls below h for a while (another approach) pays if it takes k steps with γ^k > h.
- An end without success earns nothing more: it is worse than hovering, at any level above 0.

At γ = 1 nothing of this holds within a time limit L: hovering earns h L, success in step k + 1 at least SUCCESS.
docs/train_your_own.md has what the behaviours earn.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

DISCOUNT = 0.98
"""Γ, the largest discount that the staged reward is made for."""
SUCCESS = 1.0 / (1.0 - DISCOUNT)
"""Reward of the step of success."""

WAY_WEIGHT = 0.3
"""Weight of the term `way` if there are other objects. A single target has nothing in its way."""
STAGE_WEIGHTS: Mapping[str, float] = MappingProxyType(
    {"reach": 0.15, "around": 0.1, "grasp": 0.4, "lift": 0.3, "hold": 0.05}
)
"""Weights of the other terms, as shares of what `way` leaves."""


def staged_reward(terms: Mapping[str, float], is_success: bool) -> float:
    """The reward of a step that ends in a state with these terms, which are weighted already."""
    return SUCCESS if is_success else math.fsum(terms.values())


def stage_terms(
    way: float, reach: float, around: float, grasp: float, lift: float, hold: float, num_objects: int
) -> dict[str, float]:
    """The weighted terms of a state, by their names. Their sum is 1 at most.

    Args:
        way: 1 if nothing is in the way of the target, less otherwise.
        reach: 1 at the grasp, falling with the distance from it.
        around: share of the target's height on which the fingers are around it.
        grasp: 1 if the target is held, less while the fingers close on it.
        lift: share of the height to which it must be lifted.
        hold: share of the time for which it must be held there.
        num_objects: in the scene.
    """
    share = WAY_WEIGHT if num_objects > 1 else 0.0
    is_held = grasp >= 1.0
    is_free = way >= 1.0 or is_held
    stages = {
        "reach": 1.0 if is_held else reach,
        "around": 1.0 if is_held else around,
        "grasp": grasp,
        "lift": lift if is_held else 0.0,
        "hold": hold if is_held else 0.0,
    }
    weighted = {name: (1.0 - share) * STAGE_WEIGHTS[name] * value * is_free for name, value in stages.items()}
    return {"way": share * (1.0 if is_free else way), **weighted}
