"""Base pose for a robot with a fixed base: the objects to take are in reach, and most of the others too."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planners.grasping.base_placement import MapPlacer
from planners.scene import Scene
from planners.workspace import Workspace

_PLACES = 12
"""Base poses to compare for each object."""
_DECIMALS = 3
"""Decimals of the pose [m], [rad], so that rounding on other machines decides nothing."""


def standing_place(scene: Scene, wanted: Collection[str] = ()) -> NDArray[np.float64] | None:
    """Find the base pose (3,) of the reachability map from which most objects can be taken.

    Grasps from all directions are included, blocked or not. At each pose, the robot in its home configuration is clear
    of static obstacles.

    Args:
        scene: the scene. The robot's pose and base drive are ignored.
        wanted: names of objects, by default all of the scene. The first of them that can be taken from anywhere can be
            taken from the result.

    Returns:
        None if all of these objects are out of reach from everywhere.

    Raises:
        UnknownObject: no object of a name.
    """
    scene = replace(scene, robot=scene.robot.fixed())  # the arm also reaches under a shelf from the base pose
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
