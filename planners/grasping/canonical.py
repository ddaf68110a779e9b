"""Canonical grasps: of all grasps of an object the same plain one in similar scenes, so that plans can be learned.

The base faces the gripper and both have the same yaw, as near to the world's x axis as possible; the arm is as near to
its home configuration as possible. Only where all such grasps are blocked, others are looked at: first those with the
gripper turned relative to the base, then those of the reachability map.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planners.grasping.arm_configurations import ConfigurationGrid, GripperPoses
from planners.grasping.base_placement import MapPlacer, farthest_reach
from planners.grasping.candidates import GraspCandidate, GraspCandidates, Stage, gripper_poses
from planners.grasping.facing_bases import STRAIGHT, TURNED, FacingPlacer
from planners.grasping.grasp_poses import generate_grasps
from planners.scene import Body, Scene

__all__ = ["CanonicalGrasps", "canonical_quality"]

Array = NDArray[np.float64]

_STRAIGHT, _TURNED, _MAP = range(3)
"""How base poses are chosen: see the module's docstring."""
_WORSE = 100.0
"""Quality lost by looking further: more than all other terms together."""
_YAW_COST, _TORSO_COST = 0.5, 3.0
"""Cost of a radian of the base's yaw and of a metre of the torso from home; one of the pan and the rolls is 1."""
_DECIMALS = 6
"""Of a quality: differences by rounding decide nothing."""


def canonical_quality(base: Array, q: Array, home: tuple[float, ...]) -> float:
    """Less for a base that is turned, an arm out of its vertical plane and a torso away from home.

    Args:
        base: (3,) x [m], y [m], yaw [rad].
        q: (8,) torso [m] and arm [rad].
        home: the robot's home configuration.
    """
    turns = np.remainder(q[[1, 3, 5, 7]] - np.array(home)[[1, 3, 5, 7]] + np.pi, 2 * np.pi) - np.pi
    yaw = np.remainder(base[2] + np.pi, 2 * np.pi) - np.pi
    cost = _YAW_COST * abs(yaw) + np.abs(turns).sum() + _TORSO_COST * abs(q[0] - home[0])
    return -round(float(cost), _DECIMALS)


@dataclass
class CanonicalGrasps(GraspCandidates):
    """Grasps of a scene's objects, the canonical ones first; the placer is a `MapPlacer`."""

    def _stages(self) -> tuple[Stage, ...]:
        return tuple(Stage(family, bases) for family in self.families for bases in (_STRAIGHT, _TURNED, _MAP))

    def _of_stage(self, scene: Scene, body: Body, stage: Stage) -> Iterable[GraspCandidate]:
        found = super()._of_stage(scene, body, stage) if stage.bases == _MAP else self._facing(scene, body, stage)
        worse, home = _WORSE * self._stages().index(stage), scene.robot.home
        return [replace(grasp, quality=canonical_quality(grasp.base, grasp.q, home) - worse) for grasp in found]

    def _facing(self, scene: Scene, body: Body, stage: Stage) -> Iterable[GraspCandidate]:
        """The grasps from base poses that face the gripper."""
        grasps = generate_grasps(body, scene.robot, (stage.family,))
        if not grasps:
            return ()
        assert isinstance(self.placer, MapPlacer)
        wanted, turns = gripper_poses(grasps), STRAIGHT if stage.bases == _STRAIGHT else TURNED
        bases, index = FacingPlacer(self.placer, farthest_reach(scene.robot), turns).bases(wanted)
        poses, opening = GripperPoses(bases, wanted[index]), max(grasp.opening for grasp in grasps)
        grid = ConfigurationGrid.about_home(self.chain, scene.robot.home)
        return self._scan(scene, body, poses, grid, opening)
