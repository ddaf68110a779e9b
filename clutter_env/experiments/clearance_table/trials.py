"""One trial of the clearance table: the assessment of a scene, or the attempt of a strategy on it."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal

import gymnasium as gym
import numpy as np

from assets.robots import RobotSpec
from assets.robots import robot as find_robot
from clutter_env import time_limit
from clutter_env.experiments.clearance_table.supports import chosen_supports
from clutter_env.experiments.clearance_table.variants import VARIANTS
from planners.expert.config import ExpertConfig
from planners.expert.expert import TampExpert
from planners.planner import Planner
from planners.scene import Scene
from planners.tamp.solution import Infeasible, Solution, contacts

__all__ = ["ASSESSMENT", "Assessment", "Attempt", "Trial", "base_moves", "run_trial"]

NOT_CLEAN = "lifted, but not clean"
"""Cause of the failure of an episode in which the target was lifted and an object had fallen or been disturbed."""
ASSESSMENT = "floor"
"""In place of a strategy: compute the minimum number of clearances of the scene."""
_WARM_UP_SEED = 99_999
"""Seed of a scene that is solved before anything is timed, so that compilation and loading are not timed."""

_SAME_BASE = 1e-3
"""[m], [rad] A base that has moved less has stayed."""


@dataclass(frozen=True)
class Trial:
    """What to do on one scene.

    Attributes:
        objects: number of objects on the table.
        seed: of the environment's reset.
        strategy: `ASSESSMENT`, or a name of `VARIANTS`.
        layout: its name.
        control_mode: "joint" or "ee".
        physics: whether the expert executes the plan in physics.
        time_limit: [s] of one solve.
        grasps: name of the planner's grasp set.
        supports: where objects may be put, as for `chosen_supports`; () leaves it to the grasp set.
        robot: its name.
    """

    objects: int
    seed: int
    strategy: str
    layout: str = "paper"
    control_mode: Literal["joint", "ee"] = "joint"
    physics: bool = False
    time_limit: float = 20.0
    grasps: str = "side"
    supports: tuple[str, ...] = ()
    robot: str = "fetch"

    @property
    def key(self) -> tuple[int, int, str]:
        """Identifies it within one table."""
        return self.objects, self.seed, self.strategy


@dataclass(frozen=True)
class Assessment:
    """A scene and its floor, the minimum number of clearances with the trial's grasp set.

    Attributes:
        objects: number of objects on the table.
        seed: of the environment's reset.
        target: name of the target.
        floor: None if there is no self-clearable set, or if the scene could not be assessed.
        lower_bound: proved lower bound of the floor.
        proved: whether `floor` is proved to be the minimum.
        cause: "" or why there is no floor; "crash" if the scene could not be assessed.
        detail: traceback of a crash.
        floor_s: CPU time [s] of the computation.
        strategy: `ASSESSMENT`.
        side_floor: the floor with side grasps, whatever the grasp set: it says whether the target is obstructed.
    """

    objects: int
    seed: int
    target: str = ""
    floor: int | None = None
    lower_bound: int = 0
    proved: bool = False
    cause: str = ""
    detail: str = ""
    floor_s: float = 0.0
    strategy: str = ASSESSMENT
    side_floor: int | None = None

    @property
    def is_obstructed(self) -> bool:
        """Whether something has to be cleared before a level gripper takes the target, and can be."""
        return bool(self.side_floor)


@dataclass(frozen=True)
class Attempt:
    """The result of a strategy on a scene.

    Attributes:
        objects: number of objects on the table.
        seed: of the environment's reset.
        strategy: its name.
        solved: whether there is a plan; in physics, whether the environment reports clean success.
        cause: "" for success, "crash", "killed", or the cause of the failure.
        detail: more about it; the traceback of a crash.
        clearances: names of the objects cleared, in order.
        duplicated: number of objects cleared twice or more.
        replans: in physics, only those after deviations.
        task_plans: calls of the task planner.
        task_planning_s: CPU time [s] of the task planner.
        motion_planning_s: CPU time [s] of motion planning.
        total_s: CPU time [s] of planning.
        wall_s: wall time [s].
        sim_s: simulated time [s]: of the episode in physics, else of the plan.
        base_moves: how often the base drives between two contacts of the plan, without physics.
        steps: of the environment, in physics.
        lifted: whether the target was lifted and held, whatever else moved, in physics.
        fallen: number of objects that have fallen, in physics.
        disturbed: number of objects that have been disturbed, in physics.
        deviations: what made the expert replan, in physics.
        is_taken_alone: whether the target of a scene without a plan is taken when it stands there alone; true where
            there is a plan, and in physics, where it is not asked.
    """

    objects: int
    seed: int
    strategy: str
    solved: bool = False
    cause: str = ""
    detail: str = ""
    clearances: tuple[str, ...] = ()
    duplicated: int = 0
    replans: int = 0
    task_plans: int = 0
    task_planning_s: float = 0.0
    motion_planning_s: float = 0.0
    total_s: float = 0.0
    wall_s: float = 0.0
    sim_s: float = 0.0
    steps: int = 0
    lifted: bool = False
    fallen: int = 0
    disturbed: int = 0
    deviations: tuple[str, ...] = ()
    is_taken_alone: bool = True
    base_moves: int = 0


def run_trial(trial: Trial) -> Assessment | Attempt:
    """Run a trial; the first one of a process first compiles and loads what all need."""
    _warm_up(trial.layout, trial.control_mode, trial.grasps, trial.robot)
    if trial.strategy == ASSESSMENT:
        return _assess(trial)
    return _execute(trial) if trial.physics else _solve(trial)


def _assess(trial: Trial) -> Assessment:
    planner, scene, target = _scene(trial)
    before = time.process_time()
    floor = planner.clearance_floor(scene, target)
    spent = time.process_time() - before
    side = floor if trial.grasps == "side" else replace(planner, grasps="side").clearance_floor(scene, target)
    return Assessment(
        trial.objects,
        trial.seed,
        target,
        floor.count,
        floor.lower_bound,
        floor.proved,
        floor.cause,
        floor_s=spent,
        side_floor=side.count,
    )


def _solve(trial: Trial) -> Attempt:
    planner, scene, target = _scene(trial)
    before = time.perf_counter()
    rng = np.random.default_rng(trial.seed)
    variant = VARIANTS[trial.strategy]
    planner, scene = variant.planner(planner, scene), replace(scene, robot=variant.robot(scene.robot))
    outcome = planner.solve(scene, target, variant.strategy, rng, trial.time_limit)
    wall_s = time.perf_counter() - before
    failed = isinstance(outcome, Infeasible)
    alone = replace(scene, objects=(scene.body(target),))
    stats = outcome.stats
    return Attempt(
        *trial.key,
        solved=not failed,
        cause=str(outcome.cause) if isinstance(outcome, Infeasible) else "",
        detail=outcome.detail if isinstance(outcome, Infeasible) else "",
        clearances=outcome.clearances,
        duplicated=_repeated(outcome.clearances),
        replans=stats.replans,
        task_plans=stats.task_plans,
        task_planning_s=stats.task_planning_s,
        motion_planning_s=stats.motion_planning_s,
        total_s=stats.total_s,
        wall_s=wall_s,
        sim_s=outcome.duration if isinstance(outcome, Solution) else 0.0,
        base_moves=base_moves(outcome) if isinstance(outcome, Solution) else 0,
        is_taken_alone=not failed or isinstance(planner.solve(alone, target, variant.strategy, rng), Solution),
    )


def _execute(trial: Trial) -> Attempt:
    """Let the expert execute its plans in physics."""
    variant = VARIANTS[trial.strategy]
    robot = variant.robot(find_robot(trial.robot))
    planner, scene, target = _scene(trial, robot)
    env = _environment(trial.objects, trial.layout, trial.control_mode, robot)
    unwrapped: Any = env.unwrapped
    info = unwrapped.info
    before = time.perf_counter()
    config = ExpertConfig(planning_s=trial.time_limit, with_floor=False)
    expert = TampExpert(env, variant.strategy, planner=variant.planner(planner, scene), config=config)
    expert.reset(target)
    over, steps, lifted = expert.done, 0, False
    while not over:
        _, _, terminated, truncated, info = env.step(expert.act())
        lifted |= info["lifted"]
        over = terminated or truncated or expert.done
        steps += 1
    report = expert.report
    solved = bool(info["is_success"])
    failure = NOT_CLEAN if lifted and not solved else report.failure
    return Attempt(
        *trial.key,
        solved=solved,
        cause="" if solved else _cause(failure, steps),
        detail="" if solved else failure,
        clearances=report.clearances,
        duplicated=len(report.duplicated),
        replans=report.replans,
        total_s=report.planning_s,
        wall_s=time.perf_counter() - before,
        sim_s=report.sim_s,
        steps=steps,
        lifted=lifted,
        fallen=int(info["num_fallen"]),
        disturbed=int(info["num_disturbed"]),
        deviations=report.deviations,
    )


def base_moves(solution: Solution) -> int:
    """How often the base stands elsewhere when fingers close or open than the time before, or than at the start."""
    if not solution.actions:
        return 0
    bases = [solution.actions[0].trajectory.base[0], *(contact.base for contact in contacts(solution))]
    return int((np.abs(np.diff(bases, axis=0)).max(axis=1) > _SAME_BASE).sum())


def _cause(failure: str, steps: int) -> str:
    """The kind of a failure, without the details of the single case after a colon or a semicolon."""
    return failure.partition(":")[0].partition(";")[0] or f"no success after {steps} steps"


def _repeated(names: tuple[str, ...]) -> int:
    return sum(names.count(name) > 1 for name in set(names))


def _scene(trial: Trial, robot: RobotSpec | None = None) -> tuple[Planner, Scene, str]:
    """The scene, with the trial's own robot if no other is given."""
    env = _environment(trial.objects, trial.layout, trial.control_mode, robot or find_robot(trial.robot))
    _, info = env.reset(seed=trial.seed)
    unwrapped: Any = env.unwrapped
    scene = Scene.from_mujoco(unwrapped.model, unwrapped.data, unwrapped.robot)
    follower = unwrapped.tcp_follower() if trial.control_mode == "ee" else None
    supports = chosen_supports(trial.layout, trial.supports)
    planner = Planner(unwrapped.robot, follower=follower, grasps=trial.grasps, supports=supports)
    return planner, scene, info["target"]


@cache
def _environment(objects: int, layout: str, control_mode: str, robot: RobotSpec) -> gym.Env:
    keywords: dict[str, Any] = {"num_objects": objects, "layout": layout, "robot": robot, "control_mode": control_mode}
    keywords["max_episode_steps"] = time_limit(objects)
    return gym.make("clutter_env/Retrieve-o15-v0", disable_env_checker=True, **keywords)


@cache
def _warm_up(layout: str, control_mode: Literal["joint", "ee"], grasps: str, robot: str) -> None:
    trial = Trial(15, _WARM_UP_SEED, "lookahead", layout, control_mode, grasps=grasps, robot=robot)
    planner, scene, target = _scene(trial)
    planner.clearance_floor(scene, target)
    planner.solve(scene, target, time_limit=trial.time_limit)
