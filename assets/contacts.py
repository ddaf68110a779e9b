"""Contacts of a robot with itself and with the ground, for the physics of the environments."""

from __future__ import annotations

from collections.abc import Sequence
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
        pairs: (s, 2) shapes of every arm that are tested against each other, see `irm.self_contact`, and shapes of two
            different arms. While one arm moves, the rule takes the first links of two arms for neighbours.
        above_ground: (g,) shapes that may hit the ground. Shapes of the base are left out: its wheels stand on the
            ground, and it cannot tilt.
        solid: (k,) all shapes.
    """

    pairs: NDArray[np.int64]
    above_ground: NDArray[np.int64]
    solid: NDArray[np.int64]


def paired_name(geom: int) -> str:
    """Name in a simulation of a geom without a name in the robot's MJCF file, by its id there. Pairs need names."""
    return f"robot_geom_{geom}"


@cache
def robot_contacts(robot: RobotSpec) -> RobotContacts:
    """Read the robot's contacts from its MJCF file, once. Joints that stay still are in `still_configuration`."""
    import mujoco  # the environments have the simulator, a robot's data do not need it

    from irm.self_contact import BASE, is_solid, link_of_body

    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    of_robot = model.body_rootid[model.geom_bodyid] == model.body(robot.base_body).id
    geoms = np.flatnonzero(is_solid(model) & of_robot)
    arms = [robot, *(robot.using(arm.name) for arm in robot.idle_arms)]
    found = [*(_pairs(model, geoms, arm) for arm in arms), _pairs_of_arms(model, geoms, arms)]
    pairs = np.unique(np.sort(np.concatenate(found), axis=1), axis=0)
    links = link_of_body(model, [joint for arm in arms for joint in arm.drive_joints[3:]])
    on_base = np.array([links[body] == BASE for body in model.geom_bodyid[geoms]])
    return RobotContacts(pairs, geoms[~on_base], geoms)


def _pairs(model: mujoco.MjModel, geoms: NDArray[np.int64], robot: RobotSpec) -> NDArray[np.int64]:
    """Pairs (s, 2) of geom ids to test while the active arm moves and the others stay still."""
    from irm.self_contact import counted_pairs, is_excluded, link_of_body  # see `robot_contacts`

    qpos, links = np.zeros(model.nq), link_of_body(model, robot.drive_joints[3:])
    for joint, position in zip(robot.still_joints, robot.still_configuration, strict=True):
        qpos[model.joint(joint).qposadr[0]] = position
    joints = [model.joint(link.joint).id for link in robot.chain]
    pairs = geoms[counted_pairs(model, qpos, geoms.tolist(), links, joints)]
    return np.asarray(pairs[~is_excluded(model, pairs)])


def _pairs_of_arms(model: mujoco.MjModel, geoms: NDArray[np.int64], arms: Sequence[RobotSpec]) -> NDArray[np.int64]:
    """Pairs (s, 2) of geom ids of two different arms to test while all arms move."""
    from irm.self_contact import counted_pairs, is_excluded, link_of_body  # see `robot_contacts`

    if len(arms) == 1:
        return np.empty((0, 2), np.int64)
    apart = 2 * model.njnt  # numbers of links of two arms differ by more than those of neighbours
    own = {joint: k for k, arm in enumerate(arms) for joint in arm.drive_joints[4:]}
    owners = [own[joint] for joint in own]
    links = [apart * (owners[link] + 1) if link >= 0 else 0 for link in link_of_body(model, list(own))]
    moving = [model.joint(joint).id for joint in (arms[0].drive_joints[3], *own)]
    pairs = geoms[counted_pairs(model, np.zeros(model.nq), geoms.tolist(), links, moving)]
    pairs = pairs[(np.array(links)[model.geom_bodyid[pairs]] > 0).all(axis=1)]
    return np.asarray(pairs[~is_excluded(model, pairs)])
