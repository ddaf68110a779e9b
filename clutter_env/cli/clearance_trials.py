"""Trials behind `clutter-env table`: strategies on the same scenes, planned or in physics, each kept in a file."""

from __future__ import annotations

import itertools
import logging
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Literal

import gymnasium as gym
import numpy as np

from assets import RobotSpec, robot as find_robot
from clutter_env.cli.table_arguments import Arguments
from clutter_env.config import EnvConfig
from clutter_env.errors import UsageError
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.policies.playing import played
from clutter_env.reporting.files import JsonLines, changes
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
    find_strategy,
)

logger = logging.getLogger(__name__)

ASSESSMENT = "floor"
"""In place of a strategy: compute the lower bound of the scene."""
CRASH = "crash"
"""Cause of a trial that ended in an exception or a dead process. It does not depend on the strategy."""
_SAME_SETTINGS = ("layout", "physics", "control_mode", "time_limit", "grasps", "supports", "robot")
"""Arguments that all trials in one file have in common."""
_WARM_UP_SEED = 99_999
"""Seed of a scene that is solved before anything is timed, so that compilation and loading are not timed."""
_WARM_UP_OBJECTS = 15
"""Objects of that scene, or as many as the trial has: a drawer takes fewer."""
_SAME_BASE = 1e-3
"""[m], [rad] A base that has moved less has stayed."""
_SOLVE_LIMITS, _EPISODE_LIMITS = 6, 60
"""A trial without, or in, physics is killed after so many times the planner's own time limit."""
_SOLVE_S, _EPISODE_S = 1.0, 4.0
"""[s] A trial without, and in, physics, with up to 40 objects."""
_STEPS_PER_OBJECT = 1500
"""Control steps of an episode in physics for each object, as the suites grant for a pick: enough to clear all others.

The environment's own limit is made for open tables. In front of shelves a clearance takes longer.
"""
_RESETS_PER_SCENE = 50
"""Resets that are assessed for each requested obstructed scene, before giving up."""


@dataclass(frozen=True)
class Variant:
    """A row of a table: a strategy, fields of `Planner` that differ, and whether all arms of the robot act."""

    strategy: Strategy
    planner: Mapping[str, Any] = field(default_factory=dict)
    all_arms: bool = False


@dataclass(frozen=True)
class Trial:
    """A trial on the scene of a number of objects and a seed. It tries a variant, or without a variant assesses the
    scene."""

    arguments: Arguments
    objects: int
    seed: int
    strategy: str = ASSESSMENT
    variant: Variant | None = None

    @property
    def key(self) -> tuple[int, int, str]:
        """Objects, seed and strategy, which identify it within one table."""
        return self.objects, self.seed, self.strategy


@dataclass(frozen=True)
class Record:
    """Result of a trial.

    Attributes:
        objects: number of objects on the table.
        seed: of the environment's reset.
        strategy: its name, or `ASSESSMENT`.
        cause: "" for success, `CRASH`, "killed", or the cause of the failure.
        detail: details of the cause, the traceback of a crash.
        total_s: CPU time [s] of planning.
        floor: of an assessment: the lower bound. None if no self-clearable set exists, or after a crash.
        proved: whether it is proved. Otherwise fewer clearances may suffice.
        side_floor: the lower bound with side grasps, whatever the grasp set.
        solved: of an attempt: whether a plan was found. In physics: whether the environment reports clean success.
        clearances: names of the objects cleared, in order.
        replans: in physics, only those after deviations.
        task_plans: calls of the task planner.
        task_planning_s: CPU time [s] of the task planner.
        motion_planning_s: CPU time [s] of motion planning.
        sim_s: simulated time [s]: of the episode in physics, else of the plan.
        base_moves: number of drives of the base between two contacts of the plan, without physics.
        lifted: whether the target was lifted and held, whatever else moved, in physics.
        fallen, disturbed: numbers of such objects, in physics.
        deviations: causes of replanning, in physics.
        is_taken_alone: whether the target of a scene without a plan can be taken when it stands there alone. True for
            scenes with a plan, and in physics, where it is not tested.
    """

    objects: int
    seed: int
    strategy: str
    cause: str = ""
    detail: str = ""
    total_s: float = 0.0
    floor: int | None = None
    proved: bool = False
    side_floor: int | None = None
    solved: bool = False
    clearances: tuple[str, ...] = ()
    replans: int = 0
    task_plans: int = 0
    task_planning_s: float = 0.0
    motion_planning_s: float = 0.0
    sim_s: float = 0.0
    base_moves: int = 0
    lifted: bool = False
    fallen: int = 0
    disturbed: int = 0
    deviations: tuple[str, ...] = ()
    is_taken_alone: bool = True

    @property
    def is_obstructed(self) -> bool:
        """Whether something has to be cleared before a level gripper takes the target, and can be."""
        return bool(self.side_floor)

    @property
    def duplicated(self) -> int:
        """Number of objects cleared twice or more."""
        return sum(count > 1 for count in Counter(self.clearances).values())


def run_trial(trial: Trial) -> Record:
    """Run a trial. The first trial of a process first compiles and loads the common code."""
    _warm_up(trial.arguments, min(trial.objects, _WARM_UP_OBJECTS))
    if trial.variant is None:
        return _assess(trial)
    return (_execute if trial.arguments.physics else _solve)(trial, trial.variant)


def _assess(trial: Trial) -> Record:
    _, planner, scene, target = _scene(trial)
    before = time.process_time()
    floor = planner.clearance_floor(scene, target)
    total_s = time.process_time() - before
    side = floor if planner.grasps == "side" else replace(planner, grasps="side").clearance_floor(scene, target)
    return Record(*trial.key, floor.cause, "", total_s, floor.count, floor.proved, side.count)


def _solve(trial: Trial, variant: Variant) -> Record:
    # Plans of several arms are made in the scene of the single-arm robot, which decides whether the target is
    # obstructed.
    _, planner, scene, target = _scene(trial)
    rng = np.random.default_rng(trial.seed)
    planner = replace(planner, robot=_robot(trial.arguments, variant), **variant.planner)
    scene = replace(scene, robot=planner.robot)
    outcome = planner.solve(scene, target, variant.strategy, rng, trial.arguments.time_limit)
    spent = ("replans", "task_plans", "task_planning_s", "motion_planning_s", "total_s")
    of_stats = {name: getattr(outcome.stats, name) for name in spent}
    attempt = Record(*trial.key, clearances=outcome.clearances, **of_stats)
    if isinstance(outcome, Infeasible):
        alone = planner.solve(replace(scene, objects=(scene.body(target),)), target, variant.strategy, rng)
        taken = isinstance(alone, Solution)
        return replace(attempt, cause=str(outcome.cause), detail=outcome.detail, is_taken_alone=taken)
    return replace(attempt, solved=True, sim_s=outcome.duration, base_moves=base_moves(outcome))


def _execute(trial: Trial, variant: Variant) -> Record:
    env, planner, _, target = _scene(trial, variant)
    config = ExpertConfig(planning_s=trial.arguments.time_limit, with_floor=False)
    expert = TampExpert(env, variant.strategy, planner=replace(planner, **variant.planner), config=config)
    expert.reset(target)
    info, lifted = let_act(expert, env)
    report, solved = expert.report, bool(info["is_success"])
    failure = "lifted, but not clean" if lifted and not solved else report.failure or "no success in time"
    return Record(
        *trial.key,
        # The kind of a failure, without the details of the single case after a colon or a semicolon.
        cause="" if solved else failure.partition(":")[0].partition(";")[0],
        detail="" if solved else failure,
        solved=solved,
        clearances=report.clearances,
        replans=report.replans,
        total_s=report.planning_s,
        sim_s=report.sim_s,
        lifted=lifted,
        fallen=int(info["num_fallen"]),
        disturbed=int(info["num_disturbed"]),
        deviations=report.deviations,
    )


def let_act(
    expert: TampExpert, env: gym.Env, watch: Callable[[str], object] = lambda _: None
) -> tuple[Mapping[str, Any], bool]:
    """Let an expert that has planned act until the episode ends. Return the last info, and whether the target was
    lifted.

    `watch` is called after every step with the phase of the motion.
    """
    inner: Any = env.unwrapped
    info, lifted = inner.info, False
    for step in played(expert, env.step):
        info, lifted = step.info, lifted or step.info["lifted"]
        watch(expert.phase)
    return info, lifted


def base_moves(solution: Solution) -> int:
    """Number of times that the base has moved when fingers close or open, since the last time or the start."""
    if not solution.actions:
        return 0
    bases = [solution.actions[0].trajectory.base[0], *(contact.base for contact in contacts(solution))]
    return int((np.abs(np.diff(bases, axis=0)).max(axis=1) > _SAME_BASE).sum())


def _scene(trial: Trial, variant: Variant | None = None) -> tuple[gym.Env, Planner, Scene, str]:
    """The environment after its reset, the planner, the scene and its target. A variant may change the robot."""
    arguments = trial.arguments
    env = _environment(trial.objects, arguments.layout, arguments.control_mode, _robot(arguments, variant))
    _, info = env.reset(seed=trial.seed)
    inner: Any = env.unwrapped
    scene = Scene.from_mujoco(inner.model, inner.data, inner.robot)
    follower = inner.tcp_follower() if arguments.control_mode == "ee" else None
    planner = Planner(inner.robot, follower=follower, grasps=arguments.grasps, supports=support_names(arguments))
    return env, planner, scene, info["target"]


def _robot(arguments: Arguments, variant: Variant | None) -> RobotSpec:
    robot = find_robot(arguments.robot)
    return robot.with_all_arms() if variant and variant.all_arms else robot


@cache
def _environment(objects: int, layout: str, control_mode: str, robot: RobotSpec) -> gym.Env:
    keywords: dict[str, Any] = {"num_objects": objects, "layout": layout, "robot": robot, "control_mode": control_mode}
    keywords["max_episode_steps"] = _STEPS_PER_OBJECT * objects
    return gym.make("clutter_env/Retrieve-o15-v0", disable_env_checker=True, **keywords)


@cache
def _warm_up(arguments: Arguments, objects: int) -> None:
    _, planner, scene, target = _scene(Trial(replace(arguments, supports=()), objects, _WARM_UP_SEED))
    planner.clearance_floor(scene, target)
    planner.solve(scene, target, time_limit=arguments.time_limit)


def support_names(arguments: Arguments) -> Literal["all"] | tuple[str, ...] | None:
    """The supports as in `solve`. None leaves them to the grasp set.

    Raises:
        UsageError: the layout has no such support. The message lists its supports.
    """
    if arguments.supports in ((), ("all",)):
        return "all" if arguments.supports else None
    declared = supports_of(find_layout(arguments.layout))
    names = tuple(TABLE if name == "table" else name for name in arguments.supports)
    if unknown := [name for name in names if name not in declared]:
        raise UsageError(
            f"--supports {' '.join(unknown)} is not valid in layout {arguments.layout!r}; "
            f"valid ones: all (alone), table, {', '.join(declared)}"
        )
    return names


class Trials:
    """The scenes and the rows of a table, and the file of its trials, with one JSON object per line, written as each
    ends.

    Args:
        arguments: numbers of objects, scenes, and the settings of all trials.
        more: rows by name besides the strategies of the arguments. All are compared with the first strategy.

    Raises:
        UsageError: a number that is not valid, an unknown support, or a file that was begun with other settings.
        ConfigError: an unknown layout or robot, or more objects than the layout holds. Nothing has been written then.
        UnknownStrategy: no such strategy.
    """

    def __init__(self, arguments: Arguments, more: Mapping[str, Variant] | None = None) -> None:
        self.arguments = arguments
        self.variants = {name: Variant(find_strategy(name)) for name in arguments.strategies} | dict(more or {})
        if not (arguments.objects and self.variants):
            raise UsageError("--objects and --strategies need at least one value each")
        if not arguments.time_limit > 0:
            raise UsageError(f"--time-limit {arguments.time_limit} is not valid; it must be above 0")
        for count in arguments.objects:
            if not 1 <= count <= MAX_OBJECTS:
                raise UsageError(f"--objects {count} is not valid; it must be from 1 to {MAX_OBJECTS}")
            EnvConfig(num_objects=count, layout=arguments.layout, robot=arguments.robot)
        if arguments.scenes < 1:
            raise UsageError(f"--scenes {arguments.scenes} is not valid; it must be at least 1")
        support_names(arguments)
        self._known: dict[tuple[int, int, str], Record] = {}
        self._file = JsonLines(arguments.out / "trials.jsonl")
        self.settings = {name: getattr(arguments, name) for name in _SAME_SETTINGS}
        self.settings["supports"] = " ".join(arguments.supports)
        if not self._file.values:
            self._file.append(self.settings)
        header, *rows = self._file.values
        if different := changes(header, self.settings):
            raise UsageError(
                f"{arguments.out} holds trials of other settings ({'; '.join(different)}); choose another --out"
            )
        for row in rows:
            values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in row.items()}
            if values["cause"] != CRASH:  # those are tried again
                self._keep(Record(**values))

    def run(self) -> None:
        """Make all trials that are not in the file yet, in parallel."""
        arguments = self.arguments
        print(f"first each of {arguments.workers} processes loads or compiles the planner's kernels and maps")
        for objects in arguments.objects:
            missing = (Trial(arguments, objects, seed) for seed in self._seeds_to_assess(objects))
            with progress_bar(desc=f"scenes with {objects} objects", unit="reset") as bar:
                for _ in self._make(missing):
                    bar.update()
                    bar.set_postfix(obstructed=len(self.seeds(objects)))
        trials = [
            Trial(arguments, objects, seed, name, variant)
            for objects in arguments.objects
            for seed in self.seeds(objects)
            for name, variant in self.variants.items()
        ]
        todo = [trial for trial in trials if trial.key not in self._known]
        causes: Counter[str] = Counter()
        done = len(trials) - len(todo)
        seconds = len(todo) * (_EPISODE_S if arguments.physics else _SOLVE_S) / arguments.workers
        with progress_bar(desc="strategies", total=len(trials), initial=done, unit="trial", seconds=seconds) as bar:
            for record in self._make(todo):
                causes[record.cause or "solved"] += 1
                bar.update()
                bar.set_postfix_str(", ".join(f"{cause} {count}" for cause, count in causes.most_common(3)))

    def seeds(self, objects: int, before: int | None = None) -> list[int]:
        """The seeds of the table's scenes: the first suitable ones, all below `before` if it is given."""
        found, arguments = self.assessments(objects), self.arguments
        counts = [seed for seed, scene in found.items() if scene.is_obstructed or not arguments.obstructed]
        return [seed for seed in counts if before is None or seed < before][: arguments.scenes]

    def assessments(self, objects: int) -> dict[int, Record]:
        """The assessed scenes with so many objects, by seed in ascending order, from the first seed on."""
        return {
            seed: record
            for (count, seed, name), record in sorted(self._known.items())
            if (count, name) == (objects, ASSESSMENT) and seed >= self.arguments.seed
        }

    def floors(self, objects: int) -> dict[int, int]:
        """The lower bounds by seed, as far as they are proved."""
        found = self.assessments(objects)
        return {seed: scene.floor for seed, scene in found.items() if scene.proved and scene.floor is not None}

    def attempts(self, objects: int, name: str) -> dict[int, Record]:
        """The attempts of a row on the table's scenes, by seed, as far as they have been made."""
        seeds = self.seeds(objects)
        return {seed: self._known[objects, seed, name] for seed in seeds if (objects, seed, name) in self._known}

    def add(self, record: Record) -> None:
        """Add a record, and write it to the disk."""
        self._file.append(record)
        self._keep(record)

    def _keep(self, record: Record) -> None:
        self._known[record.objects, record.seed, record.strategy] = record

    def _seeds_to_assess(self, objects: int) -> Iterator[int]:
        """Seeds that have not been assessed, in ascending order, until enough scenes are found."""
        first, scenes = self.arguments.seed, self.arguments.scenes
        for seed in itertools.count(first):
            if len(self.seeds(objects, before=seed)) >= scenes:
                return
            if seed - first >= scenes * _RESETS_PER_SCENE:
                logger.warning("too few obstructed scenes with %d objects: stopped at seed %d", objects, seed)
                return
            if (objects, seed, ASSESSMENT) not in self._known:
                yield seed

    def _make(self, trials: Iterable[Trial]) -> Iterator[Record]:
        """Make trials in parallel. Each record is stored before the next trial is taken."""
        arguments = self.arguments
        limit_s = arguments.time_limit * (_EPISODE_LIMITS if arguments.physics else _SOLVE_LIMITS)
        for trial, result in run_jobs(run_trial, trials, arguments.workers, limit_s):
            if isinstance(result, Crash | Killed):
                cause = CRASH if isinstance(result, Crash) else "killed"
                result = Record(*trial.key, cause=cause, detail=result.detail)
            self.add(result)
            yield result
