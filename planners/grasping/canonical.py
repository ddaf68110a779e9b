"""Canonical grasps: of all grasps of an object the same plain one in similar scenes, so that plans can be learned.

The base faces the gripper and both have the same yaw, as near to the world's x axis as possible; the arm is as near to
its home configuration as possible. Only where all such grasps are blocked, others are looked at: first those with the
gripper turned relative to the base, then those of the reachability map.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from irm.chain import ArmChain
from irm.kinematics import fk_frames
from planners.grasping.arm_configurations import ConfigurationGrid, GripperPoses, gripper_hits
from planners.grasping.base_placement import STRAIGHT, TURNED, facing_bases, farthest_reach
from planners.grasping.candidates import OFF_TABLE, GraspCandidate, GraspCandidates, Stage, gripper_poses
from planners.grasping.grasp_poses import GraspFamily, generate_grasps
from planners.scene import Body, Scene

Array = NDArray[np.float64]

_STRAIGHT, _TURNED, _MAP = range(3)
"""How base poses are chosen: see the module's docstring."""
_WORSE = 100.0
"""Quality lost by looking further: more than all other terms together."""
_YAW_COST, _TORSO_COST = 0.5, 3.0
"""Cost of a radian of the base's yaw and of a metre of the torso from home; one of the pan and the rolls is 1."""
_ACROSS = 0.7
"""Cosine of the angle between a joint's axis and the robot's y axis from which on it bends the arm in its plane."""
_DECIMALS = 6
"""Of a quality: differences by rounding decide nothing."""


def canonical_quality(base: Array, q: Array, robot: RobotSpec) -> float:
    """Less for a base that is turned, an arm out of its vertical plane and a torso away from home.

    Args:
        base: (3,) x [m], y [m], yaw [rad].
        q: (1 + n,) torso [m] and arm [rad].
        robot: whose home configuration.
    """
    home, turning = robot.home, _turning_joints(robot)
    turns = np.remainder(q[turning] - np.array(home)[turning] + np.pi, 2 * np.pi) - np.pi
    yaw = np.remainder(base[2] + np.pi, 2 * np.pi) - np.pi
    cost = _YAW_COST * abs(yaw) + np.abs(turns).sum() + _TORSO_COST * abs(q[0] - home[0])
    return -round(float(cost), _DECIMALS)


@cache
def _turning_joints(robot: RobotSpec) -> list[int]:
    """The joints that turn the arm out of its vertical plane: at home their axes are not across the robot."""
    chain = ArmChain.from_robot(robot)
    R, p = np.empty((chain.size + 1, 3, 3)), np.empty((chain.size + 1, 3))
    fk_frames(chain.offsets, chain.axes, chain.tip, np.array(robot.home), R, p)
    return [k for k in range(1, chain.size) if abs(R[k, 1, chain.axes[k]]) < _ACROSS]


@dataclass
class CanonicalGrasps(GraspCandidates):
    """Grasps of a scene's objects, the canonical ones first; for robots that act with one arm."""

    def _stages(self) -> tuple[Stage, ...]:
        return tuple(Stage(family, bases) for family in self.families for bases in (_STRAIGHT, _TURNED, _MAP))

    def _of_stage(self, scene: Scene, body: Body, stage: Stage) -> Iterable[GraspCandidate]:
        found = super()._of_stage(scene, body, stage) if stage.bases == _MAP else self._facing(scene, body, stage)
        worse, robot = _WORSE * self._stages().index(stage), scene.robot
        return [replace(grasp, quality=canonical_quality(grasp.base, grasp.q, robot) - worse) for grasp in found]

    def free_straight(self, scene: Scene, name: str, family: GraspFamily) -> Iterator[GraspCandidate]:
        """All straight grasps of an object in which nothing is hit, one for each direction; none of a held object."""
        body = scene.body(name)
        grasps = generate_grasps(body, scene.robot, (family,))
        if not grasps or name in scene.held_names or body.bottom < scene.support.top - OFF_TABLE:
            return
        wanted, opening = gripper_poses(grasps), max(grasp.opening for grasp in grasps)
        hits = gripper_hits(self.compiled.world(scene), wanted, opening, ignore=scene.mask({name}))
        poses, grid = self._facing_poses(scene, wanted[hits == 0], STRAIGHT), self._about_home(scene)
        for base, pose in zip(poses.bases, poses.gripper_poses, strict=True):
            found = self._scan(scene, body, GripperPoses(base[None], pose[None]), grid, opening)
            yield from (grasp for grasp in found if not grasp.blockers)

    def _facing(self, scene: Scene, body: Body, stage: Stage) -> Iterable[GraspCandidate]:
        """The grasps from base poses that face the gripper."""
        grasps = generate_grasps(body, scene.robot, (stage.family,))
        if not grasps:
            return ()
        turns, opening = STRAIGHT if stage.bases == _STRAIGHT else TURNED, max(grasp.opening for grasp in grasps)
        poses = self._untried(scene, body, self._facing_poses(scene, gripper_poses(grasps), turns))
        return self._scan(scene, body, poses, self._about_home(scene), opening)

    def _facing_poses(self, scene: Scene, wanted: Array, turns: tuple[float, ...]) -> GripperPoses:
        """Base poses that face the wanted gripper poses (k, 5), the least turned first."""
        placer = self.arms[scene.robot.arm_name].placer
        bases, index = facing_bases(placer, wanted, farthest_reach(scene.robot), turns)
        return GripperPoses(bases, wanted[index])

    def _about_home(self, scene: Scene) -> ConfigurationGrid:
        return ConfigurationGrid.about_home(self.arms[scene.robot.arm_name].chain, scene.robot.home)
