"""Contacts of a robot with itself and with the ground, for the physics of the environments."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import mujoco

    from assets.robot_spec import RobotSpec


class RobotContacts(NamedTuple):
    """Geoms of a robot's MJCF file, by their ids, that may touch each other or the ground.

    Attributes:
        pairs: (s, 2) shapes that count against each other, of every arm: see `irm.self_contact`.
        above_ground: (g,) shapes that meet the ground. The base's do not: its wheels stand there, and it cannot tilt.
        solid: (k,) all shapes.
    """

    pairs: NDArray[np.int64]
    above_ground: NDArray[np.int64]
    solid: NDArray[np.int64]


@cache
def robot_contacts(robot: RobotSpec) -> RobotContacts:
    """The contacts that count, read once from the robot's MJCF file; joints that stay are in their configuration."""
    import mujoco  # the environments have it; a robot's data do without

    from irm.self_contact import BASE, is_solid, link_of_body

    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    of_robot = model.body_rootid[model.geom_bodyid] == model.body(robot.base_body).id
    geoms = np.flatnonzero(is_solid(model) & of_robot)
    arms = [robot, *(robot.using(arm.name) for arm in robot.idle_arms)]
    pairs = np.unique(np.sort(np.concatenate([_pairs(model, geoms, arm) for arm in arms]), axis=1), axis=0)
    links = link_of_body(model, [joint for arm in arms for joint in arm.drive_joints[3:]])
    on_base = np.array([links[body] == BASE for body in model.geom_bodyid[geoms]])
    return RobotContacts(pairs, geoms[~on_base], geoms)


def _pairs(model: mujoco.MjModel, geoms: NDArray[np.int64], robot: RobotSpec) -> NDArray[np.int64]:
    """Pairs (s, 2) of ids of geoms that count while the active arm moves and the others stay."""
    from irm.self_contact import counted_pairs, is_excluded, link_of_body  # see `robot_contacts`

    qpos, links = np.zeros(model.nq), link_of_body(model, robot.drive_joints[3:])
    for joint, position in zip(robot.still_joints, robot.still_configuration, strict=True):
        qpos[model.joint(joint).qposadr[0]] = position
    joints = [model.joint(link.joint).id for link in robot.chain]
    pairs = geoms[counted_pairs(model, qpos, geoms.tolist(), links, joints)]
    return np.asarray(pairs[~is_excluded(model, pairs)])
