"""Arm configurations for level hand poses, and what each of them hits: the scan behind grasps and placements."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from irm.arm.kinematics import ArmChain
from planners.collision.robot_model import RobotArrays, robot_arrays
from planners.collision.world import CollisionWorld
from planners.grasping.arm_configuration_kernel import many_gripper_hits, scan
from planners.scene import HeldObject

__all__ = ["ArmConfigurations", "ConfigurationGrid", "GripperPoses", "gripper_hits", "scan_configurations"]

Array = NDArray[np.float64]

_VERTICAL_SLIDE = 5
"""Axis number of a joint that slides along z, as in `irm.arm.kinematics`."""


class GripperPoses(NamedTuple):
    """k pairs of a base pose and a level hand: `bases` (k, 3) and `gripper_poses` (k, 4), TCP x, y, z [m] and yaw
    [rad]."""

    bases: Array
    gripper_poses: Array


class ConfigurationGrid(NamedTuple):
    """Values of the two free parameters of the closed form: `torsos` (t,) [m], `rolls` (r,) [rad].

    `nearest_home`: of the configurations for one hand pose only the one nearest to the home configuration counts. That
    is where a robot ends up that is told TCP poses and keeps its joints near home by itself.
    """

    torsos: Array
    rolls: Array
    nearest_home: bool = False

    @classmethod
    def over(cls, chain: ArmChain, torsos: int, rolls: int) -> ConfigurationGrid:
        """Evenly spaced torso heights, off the limits, and upper-arm rolls."""
        heights = np.linspace(chain.lower[0], chain.upper[0], torsos + 2)[1:-1]
        angles = -np.pi + (np.arange(rolls) + 0.5) * (2 * np.pi / rolls)
        return cls(np.asarray(heights, np.float64), np.asarray(angles, np.float64))

    @classmethod
    def near_home(cls, chain: ArmChain, torsos: int = 10, rolls: int = 36) -> ConfigurationGrid:
        """A finer grid, of which only the configuration nearest to home counts."""
        return cls.over(chain, torsos, rolls)._replace(nearest_home=True)


class ArmConfigurations(NamedTuple):
    """m configurations: `q` (m, 8), `pair` (m,) index of the hand pose, `hits` (m,) objects as bits, `quality` (m,)."""

    q: Array
    pair: NDArray[np.int64]
    hits: NDArray[np.uint64]
    quality: Array


def scan_configurations(
    world: CollisionWorld,
    chain: ArmChain,
    poses: GripperPoses,
    grid: ConfigurationGrid,
    opening: float,
    *,
    held: HeldObject | None = None,
    ignore: int = 0,
    first_free: bool = False,
) -> ArmConfigurations:
    """Configurations that hit no static obstacle and not the robot itself; of those, the ones that hit fewest objects.

    Base poses at which the home configuration does not fit are left out, and so is a configuration if another one hits
    only a part of what it hits. Among configurations with the same hits those of
    higher quality are kept: manipulability, less a little for travel from the home configuration.

    Args:
        world: what may be hit.
        chain: arm with a closed form.
        poses: base and hand poses to try.
        grid: free parameters to try for each.
        opening: of the gripper [m].
        held: what is in hand.
        ignore: bits that do not count.
        first_free: stop after the first pose, in the order given, for which some configuration hits nothing.
    """
    known = gripper_hits(world, poses.gripper_poses, opening, held=held, ignore=ignore)
    rows = scan(
        world.robot,
        world.obstacles,
        world.attached(held),
        chain.links,
        chain.lower,
        chain.upper,
        np.array(world.scene.robot.home),
        poses.bases,
        poses.gripper_poses,
        known,
        grid.torsos,
        grid.rolls,
        opening,
        world.active(ignore),
        world.padding,
        first_free,
        grid.nearest_home,
    )
    return ArmConfigurations(*rows)


def gripper_hits(
    world: CollisionWorld, gripper_poses: Array, opening: float, *, held: HeldObject | None = None, ignore: int = 0
) -> NDArray[np.uint64]:
    """What the hand alone, and the object in it, hit at level TCP poses (k, 4): x, y, z [m], yaw [rad]. Shape (k,)."""
    hand = _gripper_arrays(world.scene.robot)
    return many_gripper_hits(
        hand, world.obstacles, world.attached(held), gripper_poses, opening, world.active(ignore), world.padding
    )


@cache
def _gripper_arrays(robot: RobotSpec) -> RobotArrays:
    """A level hand is a robot of its own: its base pose is x, y and yaw of the TCP, its only joint the height."""
    arrays = robot_arrays(robot)
    last = arrays.link == len(robot.chain) - 1
    return arrays._replace(
        offsets=np.zeros((1, 3)),
        axes=np.array([_VERTICAL_SLIDE], dtype=np.int64),
        tip=np.zeros(3),
        core=arrays.core[last],
        half=arrays.half[last],
        radius=arrays.radius[last],
        bound=arrays.bound[last],
        link=np.zeros(int(last.sum()), dtype=np.int64),
        position=arrays.position[last] - arrays.tip,
        rotation=arrays.rotation[last],
        slide=arrays.slide[last],
        slides=arrays.slides[last],
        self_pairs=np.empty((0, 2), dtype=np.int64),
        held_from=int(last.sum()),
    )
