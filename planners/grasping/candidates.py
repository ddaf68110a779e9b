"""Grasps of an object where it stands: gripper pose, base pose and arm configuration, and the blockers of each.

Canonical grasps are, of all grasps of an object, the same plain one in similar scenes, so that plans can be learned:
the base faces the gripper and both have the same yaw, as near to the world's x axis as possible; the arm is as near to
its home configuration as possible. Only where all such grasps are blocked, others are looked at: first those with the
gripper turned relative to the base, then those of the reachability map.
"""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from irm.chain import ArmChain
from irm.kinematics import link_frames
from planners.collision.opened import is_pushed, swept_objects
from planners.collision.world import CollisionWorld, CompiledScenes, objects_on
from planners.grasping.arm_configurations import (
    ArmConfigurations,
    ConfigurationGrid,
    GripperPoses,
    gripper_hits,
    hits_of,
    scan_configurations,
)
from planners.grasping.bar_grasps import BarFamily, bar_grasps, turned, with_hand_turned
from planners.grasping.base_placement import MANY_BASES, STRAIGHT, TURNED, FixedBase, Placer, facing_bases
from planners.grasping.families import SIDE, Family, families_for
from planners.grasping.grasp_poses import GraspPose, can_pull, generate_grasps
from planners.grasping.push_poses import PushFamily, push_poses
from planners.grasping.scan_kernel import Few
from planners.scene import Body, Scene
from planners.scene.cover import is_covered, needs_drive

Array = NDArray[np.float64]
_AnyFamily: TypeAlias = Family | BarFamily | PushFamily

_BASES = (0, 8)
"""Base poses for each gripper pose: the placer's own number, then more where these give no grasp, or, under a shelf, no
grasp with nothing in its way."""
_OPENINGS = 0.015
"""[m] between the openings of groups of grasps of one object."""
_REFILLS = 8
"""Times that grasps are looked for again once all of one kind are refuted, before an object counts as without more."""
_MAP: tuple[float, ...] = ()
"""Instead of the gripper's yaws relative to the base: bases of the reachability map, which may stand anyhow."""
_WORSE = 100.0
"""Quality that canonical grasps lose by each stage looked at before: more than all other terms together."""
_YAW_COST, _TORSO_COST = 0.5, 3.0
"""Cost of a radian of the base's yaw and of a metre of the torso from `RobotSpec.in_front`; one of the pan and of the
rolls is 1."""
_ACROSS = 0.7
"""Cosine of the angle between a joint's axis and the robot's y axis from which on it bends the arm in its plane."""
_ALL = (1 << 64) - 1
_DECIMALS = 6
"""Of a canonical quality: differences by rounding decide nothing."""


@dataclass(frozen=True, eq=False)
class GraspCandidate:
    """A grasp of one object: gripper pose, base pose and arm configuration.

    Attributes:
        object: its name.
        base: (3,) x [m], y [m], yaw [rad].
        q: (8,) torso [m] and arm [rad] at the grasp.
        yaw, pitch: [rad] of the gripper in the world; pitch 0 is level, π/2 points down.
        opening: of the gripper [m] before the fingers close.
        blockers: mask of the objects hit at the grasp, standing on the object, or known to be in the way to or from it.
        quality: larger is better.
        drives: whether the base drives straight in and out with the arm rigid, as under a shelf; what is in the way of
            that is among the blockers.
        arm: name of the arm, "" for the only one of a robot.
    """

    object: str
    base: Array
    q: Array
    yaw: float
    pitch: float
    opening: float
    blockers: int
    quality: float
    drives: bool = False
    arm: str = ""

    @property
    def key(self) -> tuple[str, bytes, bytes]:
        """Identifies the candidate across scenes."""
        return self.object, self.base.tobytes(), self.arm.encode() + self.q.tobytes()

    @property
    def pair(self) -> tuple[bytes, float, float]:
        """Identifies the base pose and the gripper pose among the grasps of the object."""
        return self.base.tobytes(), self.yaw, self.pitch


def gripper_poses(grasps: Sequence[GraspPose]) -> Array:
    """The gripper poses (k, 5) of grasps: x, y, z [m] of the TCP, yaw and pitch [rad]."""
    return np.array([(*grasp.T_world_tcp[:3, 3], grasp.yaw, grasp.pitch) for grasp in grasps]).reshape(-1, 5)


def as_candidates(
    name: str, poses: GripperPoses, opening: float, found: ArmConfigurations, arm: str, drives: bool = False
) -> list[GraspCandidate]:
    """The grasps of an object that a scan found for these gripper poses, with the gripper open by `opening` [m]."""
    candidates = []
    for q, pair, hits, quality in zip(found.q, found.pair, found.hits, found.quality, strict=True):
        yaw, pitch = map(float, poses.gripper_poses[pair, 3:])
        base, worth = poses.bases[pair], float(quality)
        candidates.append(GraspCandidate(name, base, q, yaw, pitch, opening, int(hits), worth, drives, arm))
    return candidates


class _Stage(NamedTuple):
    """A family of grasps, the yaws [rad] that the gripper may have relative to the base, whether many base poses are
    looked at, and whether many heights of the torso and angles of the arm are."""

    family: _AnyFamily
    turns: tuple[float, ...] = _MAP
    has_many_bases: bool = False
    has_many_arms: bool = False


_Grasps: TypeAlias = tuple[GraspCandidate, ...]


class _Known(NamedTuple):
    """Knowledge of one object's grasps."""

    candidates: tuple[GraspCandidate, ...]
    unseen: tuple[_Stage, ...]  # not looked at yet
    tried: frozenset[tuple[bytes, float, float]] = frozenset()  # found worse than expected by motion planning
    refills: int = 0  # how often grasps were looked for again without these
    scene: Scene | None = None  # in which the blockers are those


_Key: TypeAlias = tuple[str, str, bytes]


def _key(scene: Scene, name: str) -> _Key:
    """Identifies the grasps of an object where it stands, through the active arm."""
    return scene.robot.arm_name, name, scene.body(name).pose.tobytes()


class GraspsOfPose(NamedTuple):
    """The grasps of an object with one gripper pose.

    Attributes:
        scene: the scene, with the arm active that grasps.
        pose: (5,) TCP x, y, z [m], yaw and pitch [rad].
        opening: of the gripper [m].
        grasps: fewest blockers first, () if no base pose and arm configuration are free of static obstacles.
    """

    scene: Scene
    pose: Array
    opening: float
    grasps: tuple[GraspCandidate, ...]


@dataclass
class GraspCandidates:
    """The grasps of a scene's objects, through every arm that acts, computed when first asked for.

    The families are looked at in their order until a grasp with nothing in its way is found: no other one can change
    the minimum number of clearances then. If that grasp is removed later, the remaining families are looked at.

    Motion planning may find that a grasp is worse than expected: `ban` removes it, `obstruct` adds blockers, until the
    objects of the scene have moved. A scan keeps few of the grasps that hit the same objects, and none that hit more,
    so once all that hit the same are refuted, the object's other grasps are looked for.

    Attributes:
        arms: base poses for each arm that acts, by its name; while one of them grasps, the others are at home with what
            they hold.
        families: the grasp set.
        canonical: whether canonical grasps come first, for robots that act with one arm.
        near_home: only the configuration nearest to home, for end-effector-controlled robots.
        compiled: the compiled scenes, shared with the other users in one solve.
        refuted: grasps that were found worse than expected.
        unusable: those of them that the gripper cannot come to, or leave again.
        closely: whether many more base poses are looked at for objects of which every grasp has something in its way.
        remembers: whether grasps are kept when other objects have moved: only what these hit is looked at again. Where
            that leaves no free one, and one might be free that was left out as it hit more, grasps are looked for anew.
    """

    arms: Mapping[str, Placer]
    families: tuple[Family, ...] = (SIDE,)
    canonical: bool = False
    near_home: bool = False
    compiled: CompiledScenes = field(default_factory=CompiledScenes)
    closely: bool = False
    remembers: bool = False
    refuted: int = 0
    unusable: int = 0
    _scene: Scene | None = None
    _views: dict[str, Scene] = field(default_factory=dict)
    _known: dict[_Key, _Known] = field(default_factory=dict)
    _merged: dict[str, tuple[_Grasps, list[_Grasps]]] = field(default_factory=dict)

    def for_object(self, scene: Scene, name: str) -> tuple[GraspCandidate, ...]:
        """Grasps of that object where it stands, fewest blockers first."""
        by_arm = [self._through_arm(view, name) for view in self._views_of(scene).values()]
        merged, before = self._merged.get(name, ((), []))
        # Sorting takes longer than all else here, and most calls ask again for what has not changed.
        if len(before) != len(by_arm) or any(map(operator.is_not, by_arm, before)):
            merged = best_first(itertools.chain(*by_arm))
            self._merged[name] = merged, by_arm
        return merged

    def blockers(self, scene: Scene, name: str) -> list[int]:
        """Masks of what is in the way of each grasp of that object where it stands, fewest objects first."""
        return [grasp.blockers for grasp in self.for_object(scene, name)]

    def minimal_blockers(self, scene: Scene, name: str, few: Few) -> list[int]:
        """As `blockers`, without masks that contain another one. It takes less time, and no more grasps are kept.

        Masks of too many objects are left out if they are not known yet.
        """
        masks, few = set[int](), few._replace(also=few.also | scene.mask({name} - set(scene.held_names)))
        for view in self._views_of(scene).values():
            body, known = view.body(name), self._looked_at(view, name, has_many_bases=False)
            masks |= {grasp.blockers for grasp in known.candidates}
            for stage in known.unseen if 0 not in masks else ():
                masks |= {grasp.blockers for grasp in self._of_stage(view, body, stage, masks, few)}
        return [mask for mask in masks if not any(other & ~mask == 0 for other in masks - {mask})]

    def hit_by_gripper(self, scene: Scene, name: str) -> list[int]:
        """Masks of what the gripper alone hits at each grasp, whatever base pose and arm configuration it has."""
        masks: set[int] = set()
        for view in self._views_of(scene).values():
            world, body = self.compiled.world(view), view.body(name)
            ignore = scene.mask({name, *scene.held_names})
            for family in self._families_of(view, body):
                if isinstance(family, BarFamily):
                    return [0]
                for wanted, opening in _wanted(world, body, family):
                    masks |= set(map(int, gripper_hits(world, wanted, opening, ignore=ignore)))
        return list(masks)

    def of_all_families(self, scene: Scene, name: str) -> tuple[GraspCandidate, ...]:
        """Grasps of that object of all families, best first: others may fit the place where it is to be put."""
        self.for_object(scene, name)
        for view in self._views_of(scene).values():
            key, body = _key(view, name), view.body(name)
            known = self._known[key]
            for stage in known.unseen:
                known = known._replace(candidates=best_first((*known.candidates, *self._of_stage(view, body, stage))))
            self._known[key] = known._replace(unseen=())
        return self.for_object(scene, name)

    def by_gripper_pose(self, scene: Scene, name: str) -> Iterator[GraspsOfPose]:
        """Yield the grasps of that object for each gripper pose by itself, of the families that `for_object` looks at.

        `for_object` leaves out a grasp that hits more than one of another gripper pose. Here it stands, so that it can
        be said what is in its way. The base poses are the same.
        """
        self.for_object(scene, name)
        for view in self._views_of(scene).values():
            body, is_free = view.body(name), False
            stages, unseen = self._stages(view, body), self._known[_key(view, name)].unseen
            has_looked_closely = self.closely and not any(stage.has_many_bases for stage in unseen)
            for stage in stages:
                if stage.has_many_bases and not stage.has_many_arms:
                    break  # their gripper poses are those of before
                many = has_looked_closely or stage.has_many_arms
                for wanted, opening in _wanted(self.compiled.world(view), body, stage.family):
                    every = self._for_each(view, body, wanted, opening, stage, many)
                    for pose, grasps in zip(wanted, every, strict=True):
                        yield GraspsOfPose(view, pose, opening, best_first(grasps))
                        is_free |= any(grasp.blockers == 0 for grasp in grasps)
                if is_free:
                    break

    def _for_each(
        self, scene: Scene, body: Body, wanted: Array, opening: float, stage: _Stage, many: bool
    ) -> list[list[GraspCandidate]]:
        """The grasps of one stage for each gripper pose of (k, 5) by itself, from many base poses or from few."""
        placer, found = self.arms[scene.robot.arm_name], [list[GraspCandidate]() for _ in wanted]
        for most in (MANY_BASES,) if many else _BASES:
            bases, index = facing_bases(placer, wanted, stage.turns) if stage.turns else placer.bases(wanted, most)
            for k in range(len(wanted)):
                poses = GripperPoses(np.ascontiguousarray(bases[index == k]), wanted[index[index == k]])
                found[k] = self._scan(scene, body, poses, opening, stage) if len(poses.bases) else []
            if stage.turns or any(found):
                break
        return found

    def from_base(self, scene: Scene, name: str, base: Array) -> tuple[GraspCandidate, ...]:
        """Grasps of that object from one base pose (3,), fewest blockers first; of each arm's first family."""
        self.for_object(scene, name)
        found: list[GraspCandidate] = []
        for view in self._views_of(scene).values():
            body = view.body(name)
            for family in self._families_for(view, body):
                of_family: list[GraspCandidate] = []
                for wanted, opening in _wanted(self.compiled.world(view), body, family):
                    poses = self._untried(view, body, GripperPoses(np.tile(base, (len(wanted), 1)), wanted))
                    of_family += self._scan(view, body, poses, opening, _Stage(family))
                if of_family:
                    found += of_family
                    break
        return best_first(found)

    def blank_copy(self) -> GraspCandidates:
        """The same arms and grasp set, with nothing known of any scene."""
        return replace(self, _scene=None, _views={}, _known={}, _merged={})

    def learn(self, other: GraspCandidates) -> None:
        """Take over what is known elsewhere, in the same scene, of objects of which nothing is known here.

        From then on what is known is kept when objects move, as with `remembers`.
        """
        self._known, self.remembers = {**other._known, **self._known}, True

    @property
    def can_look_closely(self) -> bool:
        """Whether there may be more base poses than those looked at, for other objects than handles."""
        return not (self.closely or all(isinstance(arm, FixedBase) for arm in self.arms.values()))

    def looking_closely(self, scene: Scene) -> GraspCandidates:
        """The grasps known in a scene, to be joined by those from many more base poses where none has a free way."""
        views, known = self._views_of(scene), {}
        for key, one in self._known.items():
            arm, name, _ = key
            if name in scene.names:
                more = self._from_many_bases(views[arm], views[arm].body(name))
                known[key] = one._replace(unseen=(*one.unseen, *more))
        return replace(self, closely=True, _views=dict(views), _known=known, _merged={})

    def learn_for(self, scene: Scene, other: GraspCandidates) -> None:
        """Take over what is known in another scene, where a new scan would find the same in this one.

        A grasp is left out of a scan if another one hits only a part of what it hits. That stays so while no known
        grasp hits more than it did: else it may now be the better one, and there is a new scan.
        """
        self.remembers, views = True, self._views_of(scene)
        for key, known in other._known.items():
            arm, name, _ = key
            if known.scene is None or known.tried or name not in scene.names or _key(views[arm], name) != key:
                continue
            now = self._as_in(views[arm], views[arm].body(name), known)
            before = {grasp.key: grasp.blockers for grasp in known.candidates}
            if all(not one.blockers & ~before[one.key] for one in now.candidates):
                self._known[key] = now

    def ban(self, scene: Scene, grasp: GraspCandidate) -> None:
        """Remove that grasp until the scene changes."""
        self.refuted += 1
        view = self._views_of(scene)[grasp.arm]
        others = [other for other in self._through_arm(view, grasp.object) if other.key != grasp.key]
        self._keep(view, grasp, others)

    def obstruct(self, scene: Scene, grasp: GraspCandidate, blockers: int) -> None:
        """Add blockers to that grasp, as a mask: objects that are in the way to it or from it."""
        self.refuted += 1
        worse, view = replace(grasp, blockers=grasp.blockers | blockers), self._views_of(scene)[grasp.arm]
        known = self._through_arm(view, grasp.object)
        self._keep(view, grasp, [worse if other.key == grasp.key else other for other in known])

    def _views_of(self, scene: Scene) -> dict[str, Scene]:
        """The scene with each arm active; what is known of other arrangements of objects is forgotten."""
        if self._scene is not scene:
            if self._scene is None or scene.moved_since(self._scene):
                self._known, self._merged = self._known if self.remembers else {}, {}
            self._scene, self._views = scene, {arm: scene.using(arm) for arm in self.arms}
        return self._views

    def _through_arm(self, scene: Scene, name: str) -> tuple[GraspCandidate, ...]:
        """Grasps of that object with the active arm of a scene."""
        return self._looked_at(scene, name).candidates

    def _looked_at(self, scene: Scene, name: str, has_many_bases: bool = True) -> _Known:
        """Knowledge of an object's grasps once its stages were looked at, or only those before `has_many_bases`."""
        key, body = _key(scene, name), scene.body(name)
        known = self._known.get(key)
        if known is not None and self.remembers and known.scene is not scene:
            known = self._known[key] = self._as_in(scene, body, known)
        if known is None:
            known = self._known[key] = _Known((), self._stages(scene, body), scene=scene)
        while known.unseen and not any(grasp.blockers == 0 for grasp in known.candidates):
            if known.unseen[0].has_many_bases and not has_many_bases:
                break
            found = self._of_stage(scene, body, known.unseen[0], {grasp.blockers for grasp in known.candidates})
            known = known._replace(candidates=best_first((*known.candidates, *found)), unseen=known.unseen[1:])
            self._known[key] = known
        return known

    def hits_among(self, scene: Scene, name: str, grasps: Sequence[GraspCandidate], among: int) -> NDArray[np.uint64]:
        """What grasps of an object where it stands hit among the objects of a mask: masks (k,)."""
        world, body, hits = self.compiled.world(scene), scene.body(name), np.zeros(len(grasps), np.uint64)
        for opening in {grasp.opening for grasp in grasps}:
            rows = [row for row, grasp in enumerate(grasps) if grasp.opening == opening]
            some = [grasps[row] for row in rows]
            poses = np.array([(*body.position, grasp.yaw, grasp.pitch) for grasp in some])
            pairs, Q = GripperPoses(np.array([one.base for one in some]), poses), np.array([one.q for one in some])
            hits[rows] = hits_of(world, pairs, Q, opening, body, _ALL & ~among)
        return hits

    def _as_in(self, scene: Scene, body: Body, known: _Known) -> _Known:
        """What is known of an object's grasps, with what is in their way in another scene."""
        assert known.scene is not None
        moved = scene.moved_since(known.scene)
        if not moved:
            return known._replace(scene=scene)
        before, on_it = known.candidates, _moved_with(self.compiled.world(scene), body.name) & moved
        hits = self.hits_among(scene, body.name, before, moved & ~scene.mask({body.name, *scene.held_names}))
        masks = [grasp.blockers & ~moved | on_it | int(mask) for grasp, mask in zip(before, hits, strict=True)]
        if 0 not in masks and any(not grasp.blockers & ~moved for grasp in before):
            return _Known((), self._stages(scene, body), scene=scene)
        now = (
            grasp if mask == grasp.blockers else replace(grasp, blockers=mask)
            for grasp, mask in zip(before, masks, strict=True)
        )
        return known._replace(candidates=best_first(now), scene=scene)

    def _keep(self, scene: Scene, grasp: GraspCandidate, candidates: Sequence[GraspCandidate]) -> None:
        """Remember the grasps that are left without one as it was; others, where it was the last that hits the same."""
        key = _key(scene, grasp.object)
        known = self._known[key]
        known = known._replace(candidates=best_first(candidates), tried=known.tried | {grasp.pair})
        self._known[key] = known
        if known.refills < _REFILLS and not any(other.blockers == grasp.blockers for other in candidates):
            kept, body = {other.key for other in candidates}, scene.body(grasp.object)
            stages = self._stages(scene, body)
            seen = stages[: len(stages) - len(known.unseen)]
            found = [other for stage in seen for other in self._of_stage(scene, body, stage)]
            new = [other for other in found if other.key not in kept]
            self._known[key] = known._replace(candidates=best_first((*candidates, *new)), refills=known.refills + 1)

    def _stages(self, scene: Scene, body: Body) -> tuple[_Stage, ...]:
        """Where grasps of an object are looked for, in this order."""
        every_turn = (STRAIGHT, TURNED, _MAP) if self.canonical else (_MAP,)
        families = self._families_of(scene, body)
        stages = tuple(_Stage(family, turns) for family in families for turns in every_turn)
        return (*stages, *self._from_many_bases(scene, body)) if self.closely or _is_handle(scene, body) else stages

    def _from_many_bases(self, scene: Scene, body: Body) -> tuple[_Stage, ...]:
        """Where grasps of an object are looked for closely."""
        is_handle, is_fixed = _is_handle(scene, body), isinstance(self.arms[scene.robot.arm_name], FixedBase)
        if is_fixed and not is_handle:
            return ()
        families = self._families_of(scene, body)
        return tuple(_Stage(one, has_many_bases=True, has_many_arms=is_handle) for one in families)

    def _families_of(self, scene: Scene, body: Body) -> tuple[_AnyFamily, ...]:
        """The families by which an object, or the handle that it stands for, is grasped."""
        families = self._families_for(scene, body)
        if _is_handle(scene, body) and any(family.pitch < math.pi / 2 for family in self.families):
            # Else the hand stays upright.
            return (*families, BarFamily())
        return families

    def _families_for(self, scene: Scene, body: Body) -> tuple[_AnyFamily, ...]:
        """The families by which an object is grasped, or pushed."""
        return (PushFamily(self.families),) if is_pushed(scene, body.name) else families_for(body, self.families)

    def _of_stage(
        self, scene: Scene, body: Body, stage: _Stage, known: Collection[int] = (), few: Few | None = None
    ) -> list[GraspCandidate]:
        """Grasps of one stage; under a shelf, where scans take long, none that hits more than a `known` mask."""
        found: list[GraspCandidate] = []
        for wanted, opening in _wanted(self.compiled.world(scene), body, stage.family):
            if stage.turns:
                bases, index = facing_bases(self.arms[scene.robot.arm_name], wanted, stage.turns)
                poses = self._untried(scene, body, GripperPoses(bases, wanted[index]))
                found += self._scan(scene, body, poses, opening, stage)
            else:
                found += self._from_map(scene, body, wanted, opening, stage, known, few)
        if not self.canonical:
            return found
        worse, robot = _WORSE * self._stages(scene, body).index(stage), scene.robot
        return [replace(grasp, quality=_canonical_quality(grasp.base, grasp.q, robot) - worse) for grasp in found]

    def _from_map(
        self,
        scene: Scene,
        body: Body,
        wanted: Array,
        opening: float,
        stage: _Stage,
        known: Collection[int],
        few: Few | None,
    ) -> list[GraspCandidate]:
        """The grasps from base poses of the reachability map."""
        covered, placer = is_covered(scene, body.foot), self.arms[scene.robot.arm_name]
        if stage.has_many_bases:
            bases, index = placer.bases(wanted, MANY_BASES)
            poses = self._untried(scene, body, GripperPoses(bases, wanted[index]))
            return self._scan(scene, body, poses, opening, stage, known, few)
        candidates: list[GraspCandidate] = []
        before = GripperPoses(np.zeros((0, 3)), np.zeros((0, 5)))
        for most in _BASES:
            bases, index = placer.bases(wanted, most)
            if len(bases) == len(before.bases):
                break  # there are no more
            poses = self._untried(scene, body, GripperPoses(bases, wanted[index]))
            if covered:
                masks = {*known, *(grasp.blockers for grasp in candidates)}
                candidates += self._scan(scene, body, _not_among(poses, before), opening, stage, known=masks)
            else:
                candidates = self._scan(scene, body, poses, opening, stage)
            before = poses
            if any(not (covered and grasp.blockers) for grasp in candidates):
                break
        return candidates

    def _untried(self, scene: Scene, body: Body, poses: GripperPoses) -> GripperPoses:
        """The pairs of base pose and gripper pose at which no grasp of the object was refuted."""
        tried = self._known[_key(scene, body.name)].tried
        if not tried:
            return poses
        pairs = zip(poses.bases, *poses.gripper_poses.T[3:].tolist(), strict=True)
        rows = [(base.tobytes(), yaw, pitch) not in tried for base, yaw, pitch in pairs]
        return GripperPoses(poses.bases[rows], poses.gripper_poses[rows])

    def _scan(
        self,
        scene: Scene,
        body: Body,
        poses: GripperPoses,
        opening: float,
        stage: _Stage,
        known: Collection[int] = (),
        few: Few | None = None,
    ) -> list[GraspCandidate]:
        """The grasps from these base poses; under a shelf those to which the base drives with the arm rigid."""
        world, arm = self.compiled.world(scene), scene.robot.arm_name
        grid, is_across = self._grid(scene, stage), isinstance(stage.family, BarFamily)
        ignore = scene.mask({body.name, *scene.held_names})
        scanned = with_hand_turned(world) if is_across and len(poses.bases) else world
        found = scan_configurations(scanned, poses, grid, opening, body=body, ignore=ignore, known=known, few=few)
        if is_across:
            found = turned(world, poses, found, opening, ignore)
        found = found._replace(hits=found.hits | np.uint64(_moved_with(world, body.name)))
        return as_candidates(body.name, poses, opening, found, arm, needs_drive(scene, body.foot))

    def _grid(self, scene: Scene, stage: _Stage) -> ConfigurationGrid:
        """The heights of the torso and angles of the arm that are tried in a stage."""
        chain = self.arms[scene.robot.arm_name].chain
        if stage.turns:
            return ConfigurationGrid.about_home(chain, scene.robot.in_front)
        if stage.has_many_arms:
            return ConfigurationGrid.to_the_limits(chain)
        return ConfigurationGrid.near_home(chain) if self.near_home else ConfigurationGrid.over(chain)


def _wanted(world: CollisionWorld, body: Body, family: _AnyFamily) -> list[tuple[Array, float]]:
    """The gripper poses (k, 5) of a family of grasps of an object, in groups with one opening [m] of the gripper each.

    Those around a cylinder or box are one group: they open as far as the widest of them needs.
    """
    scene, groups = world.scene, dict[int, list[GraspPose]]()
    if isinstance(family, PushFamily):
        pushes = push_poses(scene, body, scene.robot, family.orientations, world)
        return [(gripper_poses(pushes), 0.0)] if pushes else []
    if isinstance(family, BarFamily):
        grasps = bar_grasps(scene, body, scene.robot)
    else:
        grasps = generate_grasps(body, scene.robot, (family,))
    for grasp in grasps if scene.pull is None else [one for one in grasps if can_pull(scene, body, one.T_world_tcp)]:
        groups.setdefault(math.ceil(grasp.opening / _OPENINGS) if body.shape == "pieces" else 0, []).append(grasp)
    return [(gripper_poses(group), max(grasp.opening for grasp in group)) for group in groups.values()]


def _is_handle(scene: Scene, body: Body) -> bool:
    """Whether an object stands for the handle of what is to be opened, which is to be grasped."""
    return scene.pull is not None and scene.pull.handle == body.name and not scene.pull.pushes


def _moved_with(world: CollisionWorld, name: str) -> int:
    """Mask of the objects that stand on one, or that what a handle pulls would touch: they go first."""
    pull = world.scene.pull
    return objects_on(world, name) | (swept_objects(world) if pull is not None and pull.handle == name else 0)


def _not_among(poses: GripperPoses, others: GripperPoses) -> GripperPoses:
    """The pairs of poses that are not among others."""
    seen = {pair.tobytes() for pair in np.hstack(others)}
    rows = [pair.tobytes() not in seen for pair in np.hstack(poses)]
    return GripperPoses(poses.bases[rows], poses.gripper_poses[rows])


def _canonical_quality(base: Array, q: Array, robot: RobotSpec) -> float:
    """Less for a base that is turned, an arm out of its vertical plane and a torso away from `RobotSpec.in_front`."""
    home, turning = robot.in_front, _turning_joints(robot)
    turns = np.remainder(q[turning] - np.array(home)[turning] + np.pi, 2 * np.pi) - np.pi
    yaw = np.remainder(base[2] + np.pi, 2 * np.pi) - np.pi
    cost = _YAW_COST * abs(yaw) + np.abs(turns).sum() + _TORSO_COST * abs(q[0] - home[0])
    return -round(float(cost), _DECIMALS)


@cache
def _turning_joints(robot: RobotSpec) -> list[int]:
    """The joints that turn the arm out of its vertical plane: their axes are not across the robot in front of it."""
    chain = ArmChain.from_robot(robot)
    R, _ = link_frames(chain, np.array(robot.in_front))
    return [k for k in range(1, chain.size) if abs(R[k, 1, chain.axes[k]]) < _ACROSS]


def best_first(candidates: Iterable[GraspCandidate]) -> tuple[GraspCandidate, ...]:
    """Those with the fewest blockers first, of these the best."""
    return tuple(sorted(candidates, key=lambda grasp: (grasp.blockers.bit_count(), -grasp.quality)))
