"""Trials of Table 1 of Lee & Kim 2019: strategies tried on the same obstructed scenes, planned or in physics."""

from __future__ import annotations

import itertools
import logging
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeAlias

import gymnasium as gym
import numpy as np

from assets import RobotSpec
from assets import robot as find_robot
from clutter_env import time_limit
from clutter_env.config import EnvConfig
from clutter_env.errors import ConfigError
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.reporting.files import JsonLines
from clutter_env.reporting.progress import progress_bar
from clutter_env.scene.layout import TABLE, find_layout, supports_of
from clutter_env.scene.object_sets import MAX_OBJECTS
from planners import (
    ExpertConfig,
    Infeasible,
    Planner,
    Scene,
    Solution,
    Strategy,
    TampExpert,
    contacts,
    find_grasp_set,
    find_strategy,
)

logger = logging.getLogger(__name__)

ASSESSMENT = "floor"
"""In place of a strategy: compute the minimum number of clearances of the scene."""
CRASH = "crash"
"""Cause of a trial that ended in an exception or a dead process; it says nothing about the strategy."""
NOT_CLEAN = "lifted, but not clean"
"""Cause of the failure of an episode in which the target was lifted and an object had fallen or been disturbed."""
_WARM_UP_SEED = 99_999
"""Seed of a scene that is solved before anything is timed, so that compilation and loading are not timed."""
_SAME_BASE = 1e-3
"""[m], [rad] A base that has moved less has stayed."""
_SOLVE_LIMITS, _EPISODE_LIMITS = 6, 60
"""A trial without, or in, physics is killed after so many times the planner's own time limit."""
_RESETS_PER_SCENE = 50
"""Resets that are assessed for each obstructed scene wanted, before giving up."""


@dataclass(frozen=True)
class Variant:
    """A row of a table: a strategy, and what else differs from the table's settings.

    Attributes:
        strategy: of the planner.
        planner: fields of `Planner` that differ.
        all_arms: whether all arms of the robot act.
    """

    strategy: Strategy
    planner: Mapping[str, Any] = field(default_factory=dict)
    all_arms: bool = False

    def robot(self, robot: RobotSpec) -> RobotSpec:
        """The robot that a table's `robot` becomes."""
        return robot.with_all_arms() if self.all_arms else robot


@dataclass(frozen=True)
class Trial:
    """What to do on one scene.

    Attributes:
        objects: number of objects on the table, the target among them.
        seed: of the environment's reset.
        strategy: `ASSESSMENT`, or the name of a strategy or variant.
        layout: its name.
        control_mode: "joint" or "ee".
        physics: whether the expert executes the plan in physics, where the environment decides about success.
        time_limit: [s] of one solve.
        grasps: name of the planner's grasp set.
        supports: where objects may be put: "all", "table" for the table top alone, or names of the layout's supports;
            () leaves it to the grasp set.
        robot: its name.
        variant: what `strategy` names; None for a strategy of the planner.
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
    variant: Variant | None = None

    @property
    def key(self) -> tuple[int, int, str]:
        """Objects, seed and strategy, which identify it within one table."""
        return self.objects, self.seed, self.strategy

    @property
    def support_names(self) -> Literal["all"] | tuple[str, ...] | None:
        """`supports` as in `solve`.

        Raises:
            ConfigError: the layout has no such support; the message lists those that it has. Or no such layout.
        """
        if self.supports in ((), ("all",)):
            return "all" if self.supports else None
        declared = supports_of(find_layout(self.layout))
        names = tuple(TABLE if name == "table" else name for name in self.supports)
        if unknown := [name for name in names if name not in declared]:
            raise ConfigError(
                f"supports={' '.join(unknown)} is not valid in layout {self.layout!r}; "
                f"valid ones: all (alone), table, {', '.join(declared)}"
            )
        return names


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
        cause: "" or why there is no floor; `CRASH` if the scene could not be assessed.
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
        cause: "" for success, `CRASH`, "killed", or the cause of the failure.
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


Record: TypeAlias = Assessment | Attempt


def run_trial(trial: Trial) -> Record:
    """Run a trial; the first one of a process first compiles and loads what all need."""
    _warm_up(trial.layout, trial.control_mode, trial.grasps, trial.robot)
    if trial.strategy == ASSESSMENT:
        return _assess(trial)
    return _execute(trial) if trial.physics else _solve(trial)


def failure_record(trial: Trial, result: Crash | Killed) -> Record:
    """The record of a trial that crashed or was killed."""
    cause = CRASH if isinstance(result, Crash) else "killed"
    detail = result.detail if isinstance(result, Crash) else f"did not end within {result.seconds:.0f} s"
    kind = Assessment if trial.strategy == ASSESSMENT else Attempt
    return kind(objects=trial.objects, seed=trial.seed, strategy=trial.strategy, cause=cause, detail=detail)


def _assess(trial: Trial) -> Assessment:
    _, planner, scene, target = _scene(trial)
    before = time.process_time()
    floor = planner.clearance_floor(scene, target)
    floor_s = time.process_time() - before
    side = floor if trial.grasps == "side" else replace(planner, grasps="side").clearance_floor(scene, target)
    return Assessment(
        objects=trial.objects,
        seed=trial.seed,
        target=target,
        floor=floor.count,
        lower_bound=floor.lower_bound,
        proved=floor.proved,
        cause=floor.cause,
        floor_s=floor_s,
        side_floor=side.count,
    )


def _solve(trial: Trial) -> Attempt:
    variant = trial.variant or Variant(find_strategy(trial.strategy))
    _, planner, scene, target = _scene(trial)
    before = time.perf_counter()
    rng = np.random.default_rng(trial.seed)
    planner = replace(planner, robot=variant.robot(planner.robot), **variant.planner)
    scene = replace(scene, robot=planner.robot)
    outcome = planner.solve(scene, target, variant.strategy, rng, trial.time_limit)
    wall_s = time.perf_counter() - before
    alone = replace(scene, objects=(scene.body(target),))
    stats = outcome.stats
    attempt = Attempt(
        *trial.key,
        clearances=outcome.clearances,
        duplicated=sum(count > 1 for count in Counter(outcome.clearances).values()),
        replans=stats.replans,
        task_plans=stats.task_plans,
        task_planning_s=stats.task_planning_s,
        motion_planning_s=stats.motion_planning_s,
        total_s=stats.total_s,
        wall_s=wall_s,
    )
    if isinstance(outcome, Infeasible):
        is_taken_alone = isinstance(planner.solve(alone, target, variant.strategy, rng), Solution)
        return replace(attempt, cause=str(outcome.cause), detail=outcome.detail, is_taken_alone=is_taken_alone)
    return replace(attempt, solved=True, sim_s=outcome.duration, base_moves=base_moves(outcome))


def _execute(trial: Trial) -> Attempt:
    """Let the expert execute its plans in physics."""
    variant = trial.variant or Variant(find_strategy(trial.strategy))
    env, planner, _, target = _scene(trial, variant)
    unwrapped: Any = env.unwrapped
    info = unwrapped.info
    before = time.perf_counter()
    config = ExpertConfig(planning_s=trial.time_limit, with_floor=False)
    expert = TampExpert(env, variant.strategy, planner=replace(planner, **variant.planner), config=config)
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
    # The kind of a failure, without the details of the single case after a colon or a semicolon.
    cause = failure.partition(":")[0].partition(";")[0] or f"no success after {steps} steps"
    return Attempt(
        *trial.key,
        solved=solved,
        cause="" if solved else cause,
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


def _scene(trial: Trial, variant: Variant | None = None) -> tuple[gym.Env, Planner, Scene, str]:
    """The environment after its reset, the planner, the scene and its target; with a variant, its robot in the scene.

    Plans of several arms are made in the scene of the robot with one, since it decides what counts as obstructed.
    """
    robot = find_robot(trial.robot)
    env = _environment(trial.objects, trial.layout, trial.control_mode, variant.robot(robot) if variant else robot)
    _, info = env.reset(seed=trial.seed)
    unwrapped: Any = env.unwrapped
    scene = Scene.from_mujoco(unwrapped.model, unwrapped.data, unwrapped.robot)
    follower = unwrapped.tcp_follower() if trial.control_mode == "ee" else None
    planner = Planner(unwrapped.robot, follower=follower, grasps=trial.grasps, supports=trial.support_names)
    return env, planner, scene, info["target"]


@cache
def _environment(objects: int, layout: str, control_mode: str, robot: RobotSpec) -> gym.Env:
    keywords: dict[str, Any] = {"num_objects": objects, "layout": layout, "robot": robot, "control_mode": control_mode}
    keywords["max_episode_steps"] = time_limit(objects)
    return gym.make("clutter_env/Retrieve-o15-v0", disable_env_checker=True, **keywords)


@cache
def _warm_up(layout: str, control_mode: Literal["joint", "ee"], grasps: str, robot: str) -> None:
    trial = Trial(15, _WARM_UP_SEED, "lookahead", layout, control_mode, grasps=grasps, robot=robot)
    _, planner, scene, target = _scene(trial)
    planner.clearance_floor(scene, target)
    planner.solve(scene, target, time_limit=trial.time_limit)


class OtherSettings(ConfigError):
    """The directory holds trials made under other settings; the message says which differ."""


class Table:
    """The scenes and the rows of a table, and the file of its trials: one JSON object a line, written as each ends.

    Args:
        common: the settings of all trials; its seed is the first one of the scenes.
        objects: numbers of objects on the table, the target among them.
        variants: the rows by name; the others are compared with the first one.
        scenes: number of scenes for each number of objects.
        only_obstructed: leave out scenes in which nothing has to be cleared, or no clearance frees the target.
        file: of the trials; one that exists is continued.

    Raises:
        ConfigError: a number that is not valid or more than the layout holds, or an unknown layout, robot or support;
            the message lists the valid ones. Nothing has been written then.
        UnknownGraspSet: no such grasp set.
        OtherSettings: the file was begun with other settings.
    """

    def __init__(
        self,
        common: Trial,
        objects: tuple[int, ...],
        variants: Mapping[str, Variant],
        scenes: int,
        only_obstructed: bool,
        file: Path,
    ) -> None:
        find_grasp_set(common.grasps)
        for count in objects:
            if not 1 <= count <= MAX_OBJECTS:
                raise ConfigError(f"objects={count} is not valid; it must be from 1 to {MAX_OBJECTS}")
            EnvConfig(num_objects=count, layout=common.layout, robot=common.robot)
        if scenes < 1:
            raise ConfigError(f"scenes={scenes} is not valid; it must be at least 1")
        _ = common.support_names
        self.common, self.objects, self.variants = common, objects, variants
        self.scenes, self.only_obstructed = scenes, only_obstructed
        # Of two records of one trial, as after --retry-crashes, the later one is valid.
        self._known: dict[tuple[int, int, str], Record] = {}
        self._file = JsonLines(file)
        settings = self.settings
        if not self._file.values:
            self._file.append(settings)
        header, *rows = self._file.values
        different = [
            f"{name}: {header.get(name)!r} there, {value!r} now"
            for name, value in settings.items()
            if header.get(name) != value
        ]
        if different:
            raise OtherSettings(f"{file} holds trials of other settings ({'; '.join(different)}); choose another --out")
        for row in rows:
            values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in row.items()}
            self._keep(Assessment(**values) if row["strategy"] == ASSESSMENT else Attempt(**values))

    @property
    def settings(self) -> dict[str, Any]:
        """The settings that all trials in one file have in common."""
        names = ("layout", "physics", "control_mode", "time_limit", "grasps")
        return {
            **{name: getattr(self.common, name) for name in names},
            "supports": " ".join(self.common.supports) or None,
            "robot": None if self.common.robot == Trial.robot else self.common.robot,
        }

    def run(self, workers: int, retry_crashes: bool = False) -> None:
        """Make all trials that are not in the file yet, in parallel; with `retry_crashes` those that crashed too."""
        for objects in self.objects:
            seeds = self._seeds_to_assess(objects, retry_crashes)
            missing = (replace(self.common, objects=objects, seed=seed, strategy=ASSESSMENT) for seed in seeds)
            with progress_bar(desc=f"scenes with {objects} objects", unit="reset") as bar:
                for _ in self._make(missing, workers):
                    bar.update()
                    bar.set_postfix(obstructed=len(self.seeds(objects)))
        trials = [
            replace(self.common, objects=objects, seed=seed, strategy=name, variant=variant)
            for objects in self.objects
            for seed in self.seeds(objects)
            for name, variant in self.variants.items()
        ]
        todo = [trial for trial in trials if self._is_missing(trial.key, retry_crashes)]
        causes: Counter[str] = Counter()
        done = len(trials) - len(todo)
        with progress_bar(desc="strategies", total=len(trials), initial=done, unit="trial") as bar:
            for record in self._make(todo, workers):
                causes[record.cause or "solved"] += 1
                bar.update()
                bar.set_postfix_str(", ".join(f"{cause} {count}" for cause, count in causes.most_common(3)))

    def seeds(self, objects: int, before: int | None = None) -> list[int]:
        """The seeds of the table's scenes: the first that count, all below `before` if it is given."""
        found = self.assessments(objects)
        last = max(found, default=self.common.seed) if before is None else before - 1
        counts = [seed for seed, scene in found.items() if scene.is_obstructed or not self.only_obstructed]
        return [seed for seed in counts if self.common.seed <= seed <= last][: self.scenes]

    def assessments(self, objects: int) -> dict[int, Assessment]:
        """The assessed scenes with so many objects, by seed in ascending order."""
        return {
            seed: record
            for (count, seed, _), record in sorted(self._known.items())
            if count == objects and isinstance(record, Assessment)
        }

    def attempts(self, objects: int, name: str) -> dict[int, Attempt]:
        """The attempts of a row on the table's scenes, by seed, as far as they have been made."""
        found = {seed: self._known.get((objects, seed, name)) for seed in self.seeds(objects)}
        return {seed: record for seed, record in found.items() if isinstance(record, Attempt)}

    def add(self, record: Record) -> None:
        """Add a record, and write it to the disk."""
        self._file.append(record)
        self._keep(record)

    def _keep(self, record: Record) -> None:
        self._known[record.objects, record.seed, record.strategy] = record

    def _seeds_to_assess(self, objects: int, retry_crashes: bool) -> Iterator[int]:
        """Seeds that have not been assessed, in ascending order, until there are enough scenes."""
        first = self.common.seed
        for seed in itertools.count(first):
            if len(self.seeds(objects, before=seed)) >= self.scenes:
                return
            if seed - first >= self.scenes * _RESETS_PER_SCENE:
                logger.warning("too few obstructed scenes with %d objects: stopped at seed %d", objects, seed)
                return
            if self._is_missing((objects, seed, ASSESSMENT), retry_crashes):
                yield seed

    def _make(self, trials: Iterable[Trial], workers: int) -> Iterator[Record]:
        """Make trials in parallel; each record is stored before the next trial is taken."""
        limit_s = self.common.time_limit * (_EPISODE_LIMITS if self.common.physics else _SOLVE_LIMITS)
        for trial, result in run_jobs(run_trial, trials, workers, limit_s):
            record = failure_record(trial, result) if isinstance(result, Crash | Killed) else result
            self.add(record)
            yield record

    def _is_missing(self, key: tuple[int, int, str], retry_crashes: bool) -> bool:
        record = self._known.get(key)
        return record is None or (retry_crashes and record.cause == CRASH)
