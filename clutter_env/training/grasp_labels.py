"""Labels of candidate picks and places by the planner's geometry: whether each is reached, and what is in its way.

`scene_of` gives the scene of an environment, of which the labels are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clutter_env.policies.high_level.candidates import Candidates
from irm import ArmChain
from planners import (
    Body,
    CollisionWorld,
    ConfigurationGrid,
    GripperPoses,
    Scene,
    gripper_opening,
    scan_configurations,
)


class Labels(NamedTuple):
    """Labels of m candidates.

    Attributes:
        is_reached: (m,) whether the arm reaches it without touching itself or furniture.
        blockers: (m,) mask of the objects touched; 0 where it is not reached.
    """

    is_reached: NDArray[np.bool_]
    blockers: NDArray[np.uint64]

    @property
    def is_free(self) -> NDArray[np.bool_]:
        """(m,) whether it is reached and nothing stands in the way."""
        return self.is_reached & (self.blockers == 0)


def label(scene: Scene, candidates: Candidates, bodies: Sequence[Body]) -> Labels:
    """Labels of candidate picks, or of places of what is held; `index` is that of the body as it stands there."""
    robot, held, world = scene.robot, scene.held, CollisionWorld.from_scene(scene)
    grid = ConfigurationGrid.about_home(ArmChain.from_robot(robot), robot.in_front)
    labels = Labels(np.zeros(len(candidates), np.bool_), np.zeros(len(candidates), np.uint64))
    for row, index in enumerate(candidates.index):
        body = bodies[index]
        own, opening = scene.mask({body.name}), gripper_opening(robot, body.half_width)
        # One at a time: scanned together, candidates that touch more objects than others would be left out.
        poses = GripperPoses(candidates.base[row : row + 1], candidates.tcp[row : row + 1])
        found = scan_configurations(world, poses, grid, opening, body=body, held=held, ignore=own)
        if len(found.q):
            # The configuration that touches the fewest objects; of these the best.
            best = np.lexsort((-found.quality, np.bitwise_count(found.hits)))[0]
            labels.is_reached[row], labels.blockers[row] = True, found.hits[best]
    return labels


def scene_of(env: Any, held: str = "") -> Scene:
    """The planner's view of an environment as it is now, with exact poses."""
    own = env.unwrapped
    return Scene.from_mujoco(own.model, own.data, own.robot, held, movable=own.object_names, support=own.support_name)
