"""What stands in the way of contacts, by the planner's geometry: the labels that decisions are learned from.

No motion is planned. A contact is free if some arm configuration reaches it that touches nothing; of several, the one
that touches the fewest objects counts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.decisions.contact_rule import ContactChoices
from irm import ArmChain
from planners import (
    ArmConfigurations,
    CollisionWorld,
    ConfigurationGrid,
    GripperPoses,
    driven_configurations,
    gripper_opening,
    is_covered,
    scan_configurations,
    stand_at,
)

__all__ = ["ContactLabels", "label_picks", "label_places"]


class ContactLabels(NamedTuple):
    """Labels of m contacts.

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


def label_picks(world: CollisionWorld, choices: ContactChoices) -> ContactLabels:
    """Labels of contacts at which objects can be taken; `index` is that of the object in the scene."""
    scene, grid = world.scene, _grid(world)
    labels = _unreached(len(choices))
    for row, index in enumerate(choices.index):
        body, poses = scene.objects[index], _poses(choices, row)
        opening, ignore = gripper_opening(scene.robot, body.half_width), 1 << int(index)
        if is_covered(scene, body.foot):
            found = driven_configurations(world, body, poses, grid, opening, ignore=ignore)
        else:
            found = scan_configurations(world, poses, grid, opening, ignore=ignore)
        _enter(labels, row, found)
    return labels


def label_places(world: CollisionWorld, choices: ContactChoices, points: NDArray[np.float64]) -> ContactLabels:
    """Labels of contacts at which the held object of a scene can be put down; `index` is that of the point (k, 3)."""
    scene, grid = world.scene, _grid(world)
    assert scene.held is not None
    labels = _unreached(len(choices))
    body = scene.body(scene.held.name)
    opening, own = gripper_opening(scene.robot, body.half_width), scene.mask(scene.held_names)
    placed = [stand_at(body, point) for point in points]
    for row, index in enumerate(choices.index):
        poses = _poses(choices, row)
        if is_covered(scene, points[index]):
            found = driven_configurations(world, placed[index], poses, grid, opening, held=scene.held, ignore=own)
        else:
            found = scan_configurations(world, poses, grid, opening, held=scene.held)
        _enter(labels, row, found)
    return labels


def _poses(choices: ContactChoices, row: int) -> GripperPoses:
    """One contact; scanned together, contacts that touch more objects than others would be left out."""
    return GripperPoses(choices.base[row : row + 1], choices.tcp[row : row + 1])


def _unreached(count: int) -> ContactLabels:
    return ContactLabels(np.zeros(count, np.bool_), np.zeros(count, np.uint64))


def _enter(labels: ContactLabels, row: int, found: ArmConfigurations) -> None:
    """Enter the configuration that touches the fewest objects; of these the best."""
    if len(found.q):
        best = np.lexsort((-found.quality, np.bitwise_count(found.hits)))[0]
        labels.is_reached[row], labels.blockers[row] = True, found.hits[best]


def _grid(world: CollisionWorld) -> ConfigurationGrid:
    robot = world.scene.robot
    return ConfigurationGrid.about_home(ArmChain.from_robot(robot), robot.home)
