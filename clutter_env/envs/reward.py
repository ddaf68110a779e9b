"""Success and reward of the retrieval task: named measurements first, then what they are worth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from clutter_env.config import CONTROL_HZ
from clutter_env.scene.layout import TABLE_HEIGHT
from clutter_env.simulation.world import Measurements, World

__all__ = ["DENSE_SCALES", "HOLD_STEPS", "LIFT_HEIGHT", "Progress", "dense_terms", "reward"]

LIFT_HEIGHT = 0.10
"""[m] above the table at which the target's lowest point counts as lifted."""
HOLD_TIME = 0.5
"""[s] for which it must stay there, held."""
HOLD_STEPS = round(HOLD_TIME * CONTROL_HZ)

REACH_SCALE = 5.0
"""[1/m] The reaching term falls to a quarter at 0.2 m."""

DENSE_SCALES: Mapping[str, float] = MappingProxyType(
    {"reach": 0.2, "grasp": 0.2, "lift": 0.5, "success": 10.0, "fallen": -1.0, "lost": -10.0}
)
"""What one unit of each term of `dense_terms` is worth in the dense reward."""


@dataclass(frozen=True)
class Progress:
    """Where the task stands after a step.

    `steps_held` control steps in a row with the target held and lifted; `lift` [m] of its lowest point above the
    table; `num_fallen` objects toppled or off the table, `newly_fallen` of them in this step.
    """

    steps_held: int = 0
    is_target_held: bool = False
    is_target_lost: bool = False
    lift: float = 0.0
    num_fallen: int = 0
    newly_fallen: int = 0

    @property
    def is_success(self) -> bool:
        """The target has been held high enough for long enough."""
        return self.steps_held >= HOLD_STEPS

    def after(self, world: World, measurements: Measurements, target: int) -> Progress:
        """The progress one control step later."""
        lift = world.lowest_point(measurements, target) - TABLE_HEIGHT
        is_held = measurements.held == target
        fallen = int(measurements.is_fallen.sum())
        return Progress(
            steps_held=self.steps_held + 1 if is_held and lift >= LIFT_HEIGHT else 0,
            is_target_held=is_held,
            is_target_lost=bool(measurements.is_off[target]),
            lift=lift,
            num_fallen=fallen,
            newly_fallen=max(fallen - self.num_fallen, 0),
        )


def reward(mode: str, world: World, measurements: Measurements, progress: Progress, target: int) -> float:
    """Sparse: 1 at success, else 0. Dense: the sum of `dense_terms` times `DENSE_SCALES`."""
    if mode == "sparse":
        return float(progress.is_success)
    terms = dense_terms(world, measurements, progress, target)
    return float(sum(DENSE_SCALES[name] * value for name, value in terms.items()))


def dense_terms(world: World, measurements: Measurements, progress: Progress, target: int) -> dict[str, float]:
    """The terms of the dense reward, each between 0 and 1 but for the count of objects newly fallen."""
    is_held = float(progress.is_target_held)
    return {
        "reach": 1.0 - math.tanh(REACH_SCALE * _grasp_distance(world, measurements, target)),
        "grasp": is_held,
        "lift": is_held * min(max(progress.lift / LIFT_HEIGHT, 0.0), 1.0),
        "success": float(progress.is_success),
        "fallen": float(progress.newly_fallen),
        "lost": float(progress.is_target_lost),
    }


def _grasp_distance(world: World, measurements: Measurements, target: int) -> float:
    """[m] from the TCP to the point on the target's axis where a side grasp holds it."""
    assert world.scene is not None
    x, y, z = (float(value) for value in world.data.site_xpos[world.index.tcp_site] - measurements.poses[target, :3])
    return math.hypot(x, y, z + float(world.scene.half_extents[target, 2]) - world.robot.grasp_height)
