"""Planning for a whole task: the entry point of the package."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from assets.robots import RobotSpec
from irm.cache import cached_map
from irm.inverse import InverseReachabilityMap
from irm.kinematics import ArmChain
from planners.base_placement import MapPlacer, free_floor
from planners.binding import Binder
from planners.clearance_floor import ClearanceFloor, FloorLimits
from planners.clearance_floor import clearance_floor as floor_of_options
from planners.engines import task_planner
from planners.grasp_options import GraspCatalogue, SamplingConfig
from planners.placements import PlacementSearch
from planners.scene import Scene
from planners.solution import Cause, Infeasible, Solution
from planners.strategies import strategy as find_strategy
from planners.symbolic import TaskPlanner
from planners.tamp import task_and_motion_plan
from planners.tamp_state import Search
from planners.tcp_following import TcpFollower
from planners.validation import validate

__all__ = ["Planner", "clearance_floor", "map_placer", "solve"]

_BASES, _BASES_NEAR_HOME = 3, 8
"""Base poses tried for each hand pose; more where only one posture counts at each."""
_ATTEMPTS = 3
"""Runs of Algorithm 1 with other random choices, for strategies that plan ahead."""


def solve(
    scene: Scene,
    target: str,
    strategy: str = "lookahead",
    rng: np.random.Generator | None = None,
    time_limit: float | None = None,
) -> Solution | Infeasible:
    """Plan to take `target` out of the clutter.

    Args:
        scene: the world, the robot in its home posture; an object may be in hand.
        target: name of the object wanted.
        strategy: "lookahead" (default), "ngr" (Lee & Kim 2019), "dogar" or "srivastava".
        rng: for sampling; the same generator state gives the same plan. Seed 0 if not given.
        time_limit: [s] of wall time, None for none.

    Returns:
        The plan with all its motions, or the cause why there is none.

    Raises:
        UnknownObject: no object of that name.
        UnknownStrategy: no strategy of that name.
        SceneError: objects overlap, or the robot is inside furniture.
    """
    return Planner(scene.robot).solve(scene, target, strategy, rng, time_limit)


def clearance_floor(scene: Scene, target: str, limits: FloorLimits | None = None) -> ClearanceFloor:
    """The exact minimum number of objects any plan must clear before it can take `target`.

    Exact for the grasps, base poses and arm postures that all strategies choose from, and for every path to them:
    only what the final grasp posture hits is counted.

    Raises:
        UnknownObject: no object of that name.
    """
    return Planner(scene.robot).clearance_floor(scene, target, limits)


def map_placer(scene: Scene, per_hand: int = _BASES) -> MapPlacer:
    """Base poses for hand poses in this scene, from the robot's cached reachability map."""
    return MapPlacer(_inverse_map(scene.robot), free_floor(scene), per_hand)


@dataclass(frozen=True)
class Planner:
    """A robot's maps and a task planner, kept between solves.

    Attributes:
        robot: which one.
        engine: name of the task planner, see `planners.engines`; None for the default.
        follower: model of how the joints follow, for a robot that is told TCP poses; None for one told joint targets.
    """

    robot: RobotSpec
    engine: str | None = None
    follower: TcpFollower | None = None

    @cached_property
    def _task_planner(self) -> TaskPlanner:
        return task_planner(self.engine)

    def solve(
        self,
        scene: Scene,
        target: str,
        strategy: str = "lookahead",
        rng: np.random.Generator | None = None,
        time_limit: float | None = None,
    ) -> Solution | Infeasible:
        """As the function `solve`."""
        scene.index(target)
        validate(scene)
        way = find_strategy(strategy)
        rng = rng or np.random.default_rng(0)
        started = time.process_time()
        deadline = math.inf if time_limit is None else time.perf_counter() + time_limit
        outcomes: list[Solution | Infeasible] = []
        for binder in self._binders(scene, rng, _ATTEMPTS if way.plans_ahead else 1):
            binder.late = lambda: time.perf_counter() > deadline
            search = Search(target, way, self._task_planner, binder)
            outcomes.append(task_and_motion_plan(search, scene))
            if _is_final(outcomes[-1], binder) or binder.late():
                break
        best = min(outcomes, key=_shortcoming)
        return replace(best, stats=replace(best.stats, total_s=time.process_time() - started))

    def clearance_floor(self, scene: Scene, target: str, limits: FloorLimits | None = None) -> ClearanceFloor:
        """As the function `clearance_floor`."""
        return floor_of_options(scene, target, _Blockers(self._catalogue(scene), scene), limits)

    def _binders(self, scene: Scene, rng: np.random.Generator, attempts: int) -> Iterator[Binder]:
        """A motion layer for each attempt; for a robot told TCP poses the first one keeps to postures near home."""
        for attempt in range(attempts + (self.follower is not None)):
            near_home = self.follower is not None and attempt == 0
            placer = map_placer(scene, _BASES_NEAR_HOME if near_home else _BASES)
            catalogue = GraspCatalogue(placer, self.chain, SamplingConfig(near_home=near_home))
            search = PlacementSearch(placer, self.chain, near_home=near_home)
            yield Binder(catalogue, search, rng, follower=self.follower)

    def _catalogue(self, scene: Scene) -> GraspCatalogue:
        return GraspCatalogue(map_placer(scene), self.chain)

    @cached_property
    def chain(self) -> ArmChain:
        """The robot's torso and arm."""
        return ArmChain.from_robot(self.robot)


def _is_final(outcome: Solution | Infeasible, binder: Binder) -> bool:
    """Whether another attempt could do no better.

    A plan that clears something twice can be bettered; a refusal cannot if the grasps, none of them banned, say so.
    """
    if isinstance(outcome, Solution):
        return not outcome.duplicated
    by_grasps = outcome.cause in (Cause.NO_SELF_CLEARABLE_SET, Cause.UNREACHABLE)
    is_proved = by_grasps and not outcome.clearances and not binder.has_banned and binder.follower is None
    return is_proved or outcome.cause is Cause.TIME_LIMIT


def _shortcoming(outcome: Solution | Infeasible) -> tuple[bool, int, int]:
    """Plans before refusals, then few objects cleared twice, then few clearances."""
    if isinstance(outcome, Infeasible):
        return True, 0, 0
    return False, len(outcome.duplicated), len(outcome.clearances)


@dataclass(frozen=True)
class _Blockers:
    """The blocker masks of a catalogue's grasps in one scene."""

    catalogue: GraspCatalogue
    scene: Scene

    def blockers(self, name: str) -> Sequence[int]:
        return [option.blockers for option in self.catalogue.options(self.scene, name)]


@cache
def _inverse_map(robot: RobotSpec) -> InverseReachabilityMap:
    return InverseReachabilityMap(cached_map(robot))
