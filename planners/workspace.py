"""The compiled workspace of a solve: everything that does not depend on the objects' poses.

Data that depends on them is kept in explicit caches: `GraspCandidates` (grasps, blockers, compiled collision worlds)
and `PlacementSearch` (swept volumes of grasps). A workspace makes new ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from assets.robots import RobotSpec
from planners.collision.ground_map import GroundMap
from planners.collision.opened import is_pushed
from planners.collision.world import CompiledScenes
from planners.grasping.bar_grasps import bar_grasps
from planners.grasping.base_placement import FixedBase, Placer, placer_of
from planners.grasping.candidates import GraspCandidates
from planners.grasping.families import Family, Grasps, find_grasp_set, grasp_set_name
from planners.grasping.grasp_poses import generate_grasps, too_wide
from planners.motion.base import BaseRoadmap
from planners.motion.tcp_following import TcpFollower
from planners.placing.placements import PlacementSearch
from planners.placing.surfaces import Supports, find_supports
from planners.scene import Scene

_BASES, _BASES_NEAR_HOME = 3, 8
"""Base poses to try for each gripper pose. Near home there are more, since each has only one arm configuration."""


class ArmsError(ValueError):
    """A choice that does not fit the number of arms that a robot acts with. The message says what does."""


@dataclass(frozen=True, eq=False)
class Workspace:
    """A robot among static obstacles, with the options of a whole solve.

    Attributes:
        arms: base poses for each acting arm, by its name.
        families: the grasp set.
        supports: names of the supports for objects put aside.
        roadmap: roadmap of the base.
        canonical: whether grasps and placements are canonical, so that plans can be learned.
        near_home: whether only arm configurations near home are used, for end-effector-controlled robots.
        follower: model of how the joints follow, for an end-effector-controlled robot.
        controller: model of a controller that must follow each motion without collision. Motions are those of joint
            control.
        saves_time: whether strategies that plan ahead prefer quick grasps. For robots that act with one arm, releases
            at which the gripper is turned least come first too.
        closely: whether many base poses are tried: for grasps of objects with something in the way of all others, and
            for put-downs at locations without any other.
        hurries: whether moves of an object are compared by their time, and motions merged thoroughly, to save time.
    """

    arms: Mapping[str, Placer]
    families: tuple[Family, ...]
    supports: tuple[str, ...]
    roadmap: BaseRoadmap
    canonical: bool = False
    near_home: bool = False
    follower: TcpFollower | None = None
    controller: TcpFollower | None = None
    saves_time: bool = False
    hurries: bool = False
    closely: bool = False

    @classmethod
    def of(
        cls,
        robot: RobotSpec,
        scene: Scene,
        *,
        grasps: Grasps = "all",
        supports: Supports = None,
        canonical: bool = False,
        follower: TcpFollower | None = None,
        saves_time: bool | None = None,
    ) -> Workspace:
        """Compile the workspace of a robot among the static obstacles and supports of a scene, for all object poses.

        The arguments are those of `planners.solve` and `planners.Planner`. The scene's robot may be anywhere.

        Raises:
            UnknownGraspSet: the grasps are neither the name of a grasp set nor families.
            UnknownSupport: the scene declares no support of a name.
        """
        ground, in_haste = GroundMap(scene), robot.acts_with_all_arms if saves_time is None else saves_time
        arms = {name: placer_of(scene.using(name), _BASES, ground) for name in robot.acting_arms}
        return cls(
            MappingProxyType(arms),
            find_grasp_set(grasps),
            find_supports(scene, supports),
            BaseRoadmap(ground),
            canonical,
            follower=follower,
            saves_time=in_haste,
            hurries=in_haste,
        )

    @property
    def shortens(self) -> bool:
        """Whether motions between contacts are merged. False under end-effector control and in canonical plans."""
        return self.follower is None and not self.canonical

    def only_near_home(self) -> Workspace:
        """The same workspace with arm configurations near home only, from more base poses."""
        arms = {name: arm.with_more(_BASES_NEAR_HOME) for name, arm in self.arms.items()}
        return replace(self, arms=MappingProxyType(arms), near_home=True)

    def looking_closely(self) -> Workspace:
        """The same workspace with many more base poses, for grasps and put-downs for which there are no free others."""
        return replace(self, closely=True)

    def anywhere(self) -> Workspace:
        """The same workspace with a base that can drive through walls, to explain a lack of grasps."""
        arms = {name: arm.anywhere() for name, arm in self.arms.items()}
        return replace(self, arms=MappingProxyType(arms))

    def grasps(self, compiled: CompiledScenes | None = None) -> GraspCandidates:
        """New, empty cache of grasps. `compiled` are collision worlds to share."""
        compiled = compiled or CompiledScenes()
        return GraspCandidates(self.arms, self.families, self.canonical, self.near_home, compiled, self.closely)

    @property
    def catalogue(self) -> str:
        """Text for the grasps that an answer holds for."""
        return f"with the grasps of {grasp_set_name(self.families)}"

    def too_wide(self, scene: Scene, name: str) -> str:
        """Reason why an object is too wide for the grasps of every arm, else ""."""
        if is_pushed(scene, name):
            return ""
        tilts = any(family.pitch < math.pi / 2 for family in self.families)
        if tilts and scene.pull is not None and scene.pull.handle == name:
            views = (scene.using(arm) for arm in self.arms)
            if any(bar_grasps(view, view.body(name), view.robot) for view in views):
                return ""
        reasons = [too_wide(scene.body(name), placer.robot, self.families) for placer in self.arms.values()]
        return "" if "" in reasons else reasons[0]

    def unreached(self, scene: Scene, names: Sequence[str]) -> str:
        """Text for objects that are out of reach, for lack of a base pose or an arm configuration."""
        listed, placers = ", ".join(names), [*self.arms.values()]
        fixed = [placer for placer in placers if isinstance(placer, FixedBase)]
        if not fixed:
            return f"no free base pose and arm configuration reach {listed}"
        words = f"the base cannot move, and no free arm configuration reaches {listed} from where it stands"
        poses = [
            np.array([grasp.T_world_tcp for grasp in generate_grasps(scene.body(name), placer.robot, self.families)])
            for name in names
            for placer in fixed
        ]
        if all(len(T) and placer.reaches_none(T) for T, placer in zip(poses, fixed * len(names), strict=True)):
            words += f"; it is proved that its joints reach none of {sum(map(len, poses))} gripper poses"
        return words

    def placements(self) -> PlacementSearch:
        """New search for placements, with a cache of swept volumes."""
        turns_least = self.saves_time and len(self.arms) == 1
        return PlacementSearch(self.arms, self.supports, self.canonical, self.near_home, turns_least, self.closely)


def check_arms(robot: RobotSpec, hold_aside: bool, is_told_tcp_poses: bool, canonical: bool) -> None:
    """Check a planner's options. Raises `ArmsError` if they do not fit the arms that the robot acts with."""
    if not isinstance(hold_aside, bool):
        raise ArmsError(f"hold_aside={hold_aside!r} is not valid; valid values: False, True")
    if hold_aside and not robot.acts_with_all_arms:
        several = bool(robot.idle_arms)
        advice = "robot.with_all_arms() does" if several else "it has one arm; valid value: hold_aside=False"
        raise ArmsError(f"hold_aside needs a robot that acts with several arms, {robot.name!r} does not; {advice}")
    if robot.acts_with_all_arms and (is_told_tcp_poses or canonical):
        what = "control mode 'ee'" if is_told_tcp_poses else "canonical plans"
        arms = ", ".join(map(repr, robot.acting_arms))
        raise ArmsError(f"{what} are for one arm; robot.using(arm) of {robot.name!r} has one of: {arms}")
