"""Where a robot whose base does not move should stand: what it is to take is in reach, and most of the rest too."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planners.grasping.base_placement import MapPlacer
from planners.scene import Scene
from planners.workspace import Workspace

_PLACES = 12
"""Base poses that are compared for each object."""
_DECIMALS = 3
"""Of the pose [m], [rad]: rounding on other machines decides nothing."""


def standing_place(scene: Scene, wanted: Collection[str] = ()) -> NDArray[np.float64] | None:
    """The base pose (3,), of those that the reachability map offers for some objects, from which most can be taken.

    Grasps of all directions count, also those that other objects block; at each pose the robot is clear of static
    obstacles in its home configuration.

    Args:
        scene: in which the robot may be anywhere; how its base moves does not matter.
        wanted: names of objects, the pose is one from which the first of them can be taken that can be taken at all;
            those of the scene if none are given.

    Returns:
        None where the robot could take none of these from anywhere.

    Raises:
        UnknownObject: no object of a name.
    """
    scene = replace(scene, robot=scene.robot.fixed())  # under a shelf too the arm reaches from where the base stands
    driving = replace(scene, robot=scene.robot.holonomic())
    workspace = Workspace.of(scene.robot, scene)
    arms = {arm: MapPlacer.of_scene(driving.using(arm)).anywhere() for arm in workspace.arms}
    candidates = replace(workspace, arms=arms).grasps()
    for name in wanted or scene.names:
        bases = [np.round(grasp.base, _DECIMALS) for grasp in candidates.for_object(scene, name)]
        places = [np.array(base) for base in dict.fromkeys(map(tuple, bases))][:_PLACES]
        counts = [sum(bool(candidates.from_base(scene, other, base)) for other in scene.names) for base in places]
        if places:
            return places[int(np.argmax(counts))]
    return None
