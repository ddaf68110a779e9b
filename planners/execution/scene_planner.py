"""The planner behind the expert: the one of this package, or any object with the same method."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from planners.execution.controlled_env import ControlledEnv
from planners.execution.errors import ExpertError
from planners.placing.surfaces import Supports
from planners.planner import Planner
from planners.scene import Scene
from planners.strategies import Strategy
from planners.tamp.solution import Infeasible, Solution

__all__ = ["ScenePlanner", "checked_outcome", "floor_of_scene", "planner_for", "warm_up"]


class ScenePlanner(Protocol):
    """What the expert needs of a planner; `planners.Planner` has it."""

    def solve(
        self,
        scene: Scene,
        target: str,
        strategy: Strategy,
        rng: np.random.Generator,
        time_limit: float | None,
        /,
    ) -> Solution | Infeasible:
        """Plan to take an object.

        Args:
            scene: the world; an object may be in the gripper.
            target: name of the object to take.
            strategy: how to clear.
            rng: for sampling.
            time_limit: [s] of wall time, None for none.
        """
        ...


def planner_for(
    env: ControlledEnv,
    planner: Any = None,
    grasps: str | None = None,
    supports: Supports = None,
    canonical: bool | None = None,
    hold_aside: bool | None = None,
) -> ScenePlanner:
    """The planner to use in an environment.

    In control mode "ee" a `Planner` without a `follower` gets that of the environment, since its motions are followed
    through TCP poses.

    Args:
        env: the environment.
        planner: a `Planner`, or any object with its `solve`; None for a new `Planner`.
        grasps: name of the grasp set of a `Planner`; None leaves it as it is.
        supports: where a `Planner` may put objects; None leaves it as it is.
        canonical: whether a `Planner` makes canonical plans; None leaves it as it is.
        hold_aside: whether one arm may hold an obstacle while another one takes the target; None leaves it as it is.

    Raises:
        ExpertError: `planner` has no method `solve`, is a planner for another robot, or is no `Planner` and thus has no
            grasps, supports or canonical plans to choose.
        UnknownGraspSet: no grasp set of that name.
        ArmsError: `hold_aside` with a robot that acts with one arm.
    """
    follower = env.tcp_follower() if env.control_mode == "ee" else None
    if planner is None:
        planner = Planner(env.robot, follower=follower)
    if isinstance(planner, type) or not callable(getattr(planner, "solve", None)):
        raise ExpertError(
            f"planner={planner!r} is not valid; it must be a Planner or an object with the method "
            "solve(scene, target, strategy, rng, time_limit)"
        )
    if not isinstance(planner, Planner):
        choices = {"grasps": grasps, "supports": supports, "canonical": canonical, "hold_aside": hold_aside}
        for name, choice in choices.items():
            if choice is not None:
                raise ExpertError(f"{name}={choice!r} is for a Planner, not for {type(planner).__name__}")
        return planner
    if planner.robot != env.robot:
        raise ExpertError(f"the planner is for robot {planner.robot.name!r}, the environment has {env.robot.name!r}")
    return replace(
        planner,
        follower=planner.follower or follower,
        grasps=planner.grasps if grasps is None else grasps,
        supports=planner.supports if supports is None else supports,
        canonical=planner.canonical if canonical is None else canonical,
        hold_aside=planner.hold_aside if hold_aside is None else hold_aside,
    )


def warm_up(planner: ScenePlanner) -> None:
    """Compile or load what a planner of this package needs, before any clock is started."""
    if isinstance(planner, Planner):
        planner.warmup()


def checked_outcome(outcome: object) -> Solution | Infeasible:
    """What a planner returned, if it is a result; raises ExpertError otherwise."""
    if not isinstance(outcome, Solution | Infeasible):
        raise ExpertError(f"the planner returned {outcome!r:.100}; it must return a Solution or an Infeasible")
    return outcome


def floor_of_scene(planner: ScenePlanner, scene: Scene, target: str) -> int | None:
    """The minimum number of objects that any plan must clear; None if it is not proved."""
    own = planner if isinstance(planner, Planner) else Planner(scene.robot)
    floor = own.clearance_floor(scene, target)
    return floor.count if floor.proved else None
