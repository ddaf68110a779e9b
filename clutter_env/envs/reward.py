"""Reward of the retrieval task: a large reward for success, penalties, and shaping by a potential of the state.

The potential Φ of a state measures how near the target is to being lifted, between 0 and `MOST`. It is 0 after the
episode has ended. A step from s to s' earns the events of the step and γ Φ(s') - Φ(s), γ = `DISCOUNT` (Ng, Harada and
Russell 1999, theorem 1). Time limit and divergence truncate an episode and do not end it: Φ is not 0 there, as a
learner goes on with its estimate of the value of that state. Φ is a function of what `save_state` keeps.

Return of an episode of T steps from the state s_0, without the penalties, which only lower it:

- Discounted by γ, shaping adds up to γ^T Φ(s_T) - Φ(s_0). Clean success at step T: γ^(T-1) S - Φ(s_0) with S = 200. No
  success within L >= T steps: at most γ^L MOST - Φ(s_0), which is less because MOST < S, whatever was done: hovering,
  oscillating, dropping and picking again, idling.
- Undiscounted, shaping adds up to Φ(s_T) - Φ(s_0) - (1 - γ) Σ Φ(s_t), t = 1 … T. Clean success: at least
  S - Φ(s_0) - (1 - γ) (T - 1) MOST. No success: at most MOST - Φ(s_0). The first is larger for
  T <= 1 + (S - MOST) / (MOST (1 - γ)) = 28,472 steps. The longest time limit, a suite's, is 22,500 steps.
- A detour that returns to its state earns (γ^k - 1) Φ <= 0 in k steps with γ, and -(1 - γ) Σ Φ <= 0 undiscounted.
- An end without success costs as much as success earns. Undiscounted, that is more than all the shaping that could
  still be lost within the time limit: to end an episode early saves nothing.

A smaller discount than γ has none of these properties. It prefers actions that raise Φ soon.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from clutter_env.envs.success import LIFT_HEIGHT, SuccessMonitor
from clutter_env.scene.layout import TABLE_HEIGHT, Layout
from clutter_env.scene.obstruction import estimate_clearances, robots_with_approaches, side_approaches
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.world import Measurements, World

DISCOUNT = 0.99
"""The discount that the dense reward is made for."""
REACH_SCALE = 5.0
"""[1/m] The reaching term falls to a quarter at 0.2 m."""
_AWAY = 100.0
"""[m] Distance from the table to which objects are moved that cannot be in the way."""
_DECIMALS = 4
"""Poses are rounded to 0.1 mm and 0.1 mrad, so that objects in the way are not counted again for jitter."""

POTENTIAL_SCALES: Mapping[str, float] = MappingProxyType({"way": 0.35, "reach": 0.07, "grasp": 0.07, "lift": 0.21})
"""Worth of each term of the potential, each between 0 and 1."""
EVENT_SCALES: Mapping[str, float] = MappingProxyType({"success": 200.0, "disturbed": -10.0, "failure": -200.0})
"""Worth of the events of a step."""
MOST = math.fsum(POTENTIAL_SCALES.values())
"""The largest potential."""


def dense_reward(before: float, after: float, events: Mapping[str, float]) -> float:
    """The reward of a step: shaping, and the events times their scales.

    Args:
        before: `potential` of the state before the step.
        after: `potential` of the state after it, 0 if the episode has ended.
        events: `event_terms` of the step.
    """
    return DISCOUNT * after - before + sum(EVENT_SCALES[name] * value for name, value in events.items())


def event_terms(monitor: SuccessMonitor, is_success: bool, is_over: bool) -> dict[str, float]:
    """Events of a step: success (0 or 1), objects newly disturbed or fallen, an end without success (0 or 1)."""
    return {
        "success": float(is_success),
        "disturbed": float(monitor.newly_disturbed),
        "failure": float(is_over and not is_success),
    }


def potential(terms: Mapping[str, float]) -> float:
    """The potential of a state with these `potential_terms`."""
    return sum(scale * terms[name] for name, scale in POTENTIAL_SCALES.items())


def potential_terms(
    world: World, measurements: Measurements, monitor: SuccessMonitor, clearances: float
) -> dict[str, float]:
    """The terms of a state's potential, each between 0 and 1: see the table in `docs/retrieve.md`.

    Args:
        world: the world, its kinematics settled.
        measurements: its measurements.
        monitor: its success monitor.
        clearances: from `Way.clearances`.
    """
    target = world.scene.target
    # From the TCP to the point on the target's axis where a side grasp holds it.
    x, y, z = (float(value) for value in world.data.site_xpos[world.index.tcp_site] - measurements.poses[target, :3])
    distance = math.hypot(x, y, z + float(world.scene.standing_extents[target, 2]) - world.robot.grasp_height)
    return {
        "way": 1.0 / (1.0 + clearances),
        "reach": 1.0 - math.tanh(REACH_SCALE * distance),
        "grasp": float(target in measurements.grip.held),
        "lift": monitor.is_target_carried * min(max(monitor.lift / LIFT_HEIGHT, 0.0), 1.0),
    }


class Way:
    """Estimates the objects in the way of the target. It keeps the last estimate, which takes longer than a step."""

    def __init__(self, robot: str, layout: Layout) -> None:
        """Begin for a robot of that full name. For a robot without a table of side approaches, nothing is in the way.

        The same holds in layouts with a drawer or a door, because these approaches are to objects on tables.
        """
        is_known = robot in robots_with_approaches() and layout.opens is None
        self._approaches = side_approaches(robot) if is_known else None
        self._layout = layout
        self._measured: Measurements | None = None
        self._scene: TableScene | None = None
        self._poses, self._clearances = b"", 0.0

    def clearances(self, world: World, measurements: Measurements) -> float:
        """`estimate_clearances` in the present state, 0 after the target is held.

        Objects that are held or off the table are in no way. Toppled objects are, as if they stood upright at their
        place, because toppling is no clearance. A toppled target is out of reach of a side grasp.
        """
        scene, held = world.scene, measurements.grip.held
        if self._approaches is None or scene.target in held:
            return 0.0
        if measurements.is_fallen[scene.target]:
            return 2.0 * scene.num_objects
        if measurements is self._measured and scene is self._scene:
            return self._clearances
        w, x, y, z = measurements.poses[:, 3:].T
        axis = np.where(scene.is_lying, (x * z + w * y, y * z - w * x), (0.5 - y * y - z * z, x * y + w * z))
        # Not `np.arctan2`, whose last bits depend on the processor.
        yaws = [math.atan2(sine, cosine) for cosine, sine in zip(axis[0].tolist(), axis[1].tolist(), strict=True)]
        poses = np.column_stack((measurements.poses[:, :3], yaws)).round(_DECIMALS)
        poses[measurements.is_off] = poses[[slot for slot in held if slot >= 0]] = _AWAY
        if scene is not self._scene or poses.tobytes() != self._poses:
            levels = np.array(self._layout.levels)
            heights = poses[:, 2] - TABLE_HEIGHT - scene.standing_extents[:, 2]
            nearest = levels[np.abs(heights[:, None] - levels).argmin(axis=1)]
            now = replace(scene, positions=poses[:, :2], yaws=poses[:, 3], levels=nearest)
            self._clearances = estimate_clearances(self._approaches, self._layout, now, world.robot.max_opening)
        self._measured, self._scene, self._poses = measurements, scene, poses.tobytes()
        return self._clearances
