"""Measure the motion layer: collision checks, arm plans, whole picks, and MuJoCo's check with steps ten times smaller.

Scenes are those of the environment. For every object with a grasp that hits nothing one pick is planned. CPU times.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, ParamSpec, TypeVar

import numpy as np
from matplotlib.figure import Figure

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.experiments.plans.truth import FINER, CheckedPlan, check_plan
from clutter_env.reporting.command import run_command
from clutter_env.reporting.files import write_json
from clutter_env.reporting.progress import progress_bar
from planners.collision.world import STEP, CollisionWorld
from planners.context import PlanningContext
from planners.grasping.candidates import GraspCandidate
from planners.motion.arm import ArmQuery, plan_arm
from planners.motion.mujoco_check import MujocoCollisionChecker
from planners.motion.path import WholeBodyPath
from planners.motion.pick_and_place import PickMotion, plan_pick
from planners.motion.timing import pick_trajectory
from planners.planner import clearance_floor
from planners.scene import Scene
from planners.tamp.solution import Infeasible

CHECKS = 20_000
Result = TypeVar("Result")
Parameters = ParamSpec("Parameters")


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    objects: tuple[int, ...] = (15, 25, 40)
    """Numbers of objects to measure."""
    scenes: int = 10
    """Scenes for each."""
    picks: int = 6
    """Objects for which a pick is planned in each scene, at most."""
    plans: int = 0
    """Whole plans to check for each number of objects, in scenes whose target is obstructed."""
    layout: str = "paper"
    grasps: Literal["side", "tilted", "top", "all"] = "side"
    """Grasp set of the picks and of the whole plans."""
    seed: int = 0
    out: Path = field(default_factory=lambda: Path("outputs/motion_benchmark.png"))
    """File of the plot."""
    json: Path | None = None
    """File of machine-readable results."""


@dataclass
class Measurement:
    """What was measured for one number of objects; times [s]."""

    objects: int
    outcomes: Counter[str] = field(default_factory=Counter)
    check: list[float] = field(default_factory=list)
    plan: list[float] = field(default_factory=list)
    checker: list[float] = field(default_factory=list)
    pick: list[float] = field(default_factory=list)
    timing: list[float] = field(default_factory=list)
    duration: list[float] = field(default_factory=list)
    penetration: list[float] = field(default_factory=list)


def run(arguments: Arguments) -> None:
    """Measure, print, save, plot."""
    measurements = [measure(count, arguments) for count in arguments.objects]
    print(table(measurements))
    for count in arguments.objects if arguments.plans else ():
        print(check_plans(count, arguments))
    if arguments.json is not None:
        write_json(arguments.json, measurements)
    plot(measurements, arguments.out)


def measure(objects: int, arguments: Arguments) -> Measurement:
    """All scenes with one number of objects."""
    result = Measurement(objects)
    env = RetrieveEnv(num_objects=objects, layout=arguments.layout)
    for seed in progress_bar(range(arguments.seed, arguments.seed + arguments.scenes), desc=f"{objects} objects"):
        env.reset(seed=seed)
        scene = Scene.from_mujoco(env.model, env.data, env.robot)
        measure_scene(scene, result, np.random.default_rng(seed), arguments)
    env.close()
    return result


def measure_scene(scene: Scene, result: Measurement, rng: np.random.Generator, arguments: Arguments) -> None:
    """Checks in one scene, then a pick for each object with a free grasp, `picks` at most."""
    most = arguments.picks
    world, checker = CollisionWorld.from_scene(scene), MujocoCollisionChecker(scene)
    home = np.array(scene.robot.home)
    for grasp in list(free_grasps(scene, arguments.grasps))[:most]:
        near = grasp.q + rng.normal(0, 0.05, (CHECKS // most, grasp.q.size))
        _, seconds = timed(world.hits_many, grasp.base, near, grasp.opening)
        result.check.append(seconds / len(near))
        motion, seconds = timed(plan_pick, world, grasp.base, home, grasp.q, grasp.object, rng=rng)
        result.outcomes[type(motion).__name__] += 1
        if not isinstance(motion, PickMotion):
            continue
        result.pick.append(seconds)
        measure_pick(scene, world, checker, motion, result, rng)


def measure_pick(
    scene: Scene,
    world: CollisionWorld,
    checker: MujocoCollisionChecker,
    motion: PickMotion,
    result: Measurement,
    rng: np.random.Generator,
) -> None:
    """One arm plan with MuJoCo's check, the timing, and MuJoCo's check with steps ten times smaller."""
    transit = motion.transit
    ends = transit.start, transit.end
    query = ArmQuery(world, transit.base, transit.opening)
    path, seconds = timed(plan_arm, query, *ends, rng=rng)
    if isinstance(path, WholeBodyPath):
        _, checking = timed(checker.deepest_penetration, path)
        result.plan.append(seconds + checking)
        result.checker.append(checking)
    trajectory, seconds = timed(pick_trajectory, scene.robot, motion, scene.state)
    result.timing.append(seconds)
    result.duration.append(trajectory.duration)
    fine = [checker.deepest_penetration(one, STEP / FINER).penetration for one in (*motion.paths, trajectory)]
    result.penetration.append(max(fine))


def free_grasps(scene: Scene, grasps: str) -> Iterator[GraspCandidate]:
    """The best grasp of every object that can be grasped without touching another."""
    candidates = PlanningContext.of(scene, grasps=grasps).grasps()
    for name in scene.names:
        yield from [option for option in candidates.for_object(scene, name) if not option.blockers][:1]


def check_plans(objects: int, arguments: Arguments) -> str:
    """What MuJoCo finds in whole plans, with steps ten times smaller than the planner's."""
    env = RetrieveEnv(num_objects=objects, layout=arguments.layout)
    checked: list[CheckedPlan] = []
    infeasible = 0
    with progress_bar(desc=f"plans with {objects} objects", total=arguments.plans) as bar:
        for seed in itertools.count(arguments.seed):
            _, info = env.reset(seed=seed)
            scene = Scene.from_mujoco(env.model, env.data, env.robot)
            if not clearance_floor(scene, info["target"], grasps=arguments.grasps).count:
                continue
            found = check_plan(scene, info["target"], seed, arguments.grasps)
            infeasible += isinstance(found, Infeasible)
            checked += [found] if isinstance(found, CheckedPlan) else []
            bar.update()
            if len(checked) + infeasible == arguments.plans:
                break
    env.close()
    worst = max(checked, key=lambda plan: plan.penetration, default=CheckedPlan())
    where = f" ({worst.action}: {' and '.join(worst.pair)})" if worst.penetration else ""
    actions = sum(plan.actions for plan in checked)
    return (
        f"{objects} objects: {len(checked)} plans with {actions} actions, {infeasible} scenes without a plan; "
        f"deepest penetration at a {FINER} times finer step {1e3 * worst.penetration:.3f} mm{where}"
    )


def timed(
    work: Callable[Parameters, Result], *args: Parameters.args, **kwargs: Parameters.kwargs
) -> tuple[Result, float]:
    """The result of a call and its CPU time [s]."""
    start = time.process_time()
    result = work(*args, **kwargs)
    return result, time.process_time() - start


def table(measurements: list[Measurement]) -> str:
    """A Markdown table: medians, and 95th percentiles after the slash."""
    columns = {"check": 1e6, "plan": 1e3, "pick": 1e3, "timing": 1e3, "duration": 1.0}
    head = (
        "objects | check [µs] | plan + MuJoCo [ms] | pick [ms] | timing [ms] | duration [s] | deepest [mm] | outcomes"
    )
    rows = [f"| {head} |", "|" + "---|" * len(head.split(" | "))]
    for m in measurements:
        outcomes = ", ".join(f"{name} {count}" for name, count in m.outcomes.most_common())
        cells = [str(m.objects), *(spread(getattr(m, name), unit) for name, unit in columns.items())]
        rows.append("| " + " | ".join([*cells, f"{1e3 * max(m.penetration, default=0):.2f}", outcomes]) + " |")
    return "\n".join(rows)


def spread(values: list[float], unit: float) -> str:
    """Median / 95th percentile."""
    return f"{unit * np.median(values):.1f} / {unit * np.percentile(values, 95):.1f}" if values else "–"


def plot(measurements: list[Measurement], file: Path) -> None:
    """How the times of arm plans and picks are distributed."""
    figure = Figure(figsize=(7, 3.5), layout="constrained")
    titles = {"plan": "arm plan with MuJoCo's check", "pick": "whole pick"}
    for axes, (name, title) in zip(figure.subplots(1, 2), titles.items(), strict=True):
        axes.boxplot([1e3 * np.array(getattr(m, name)) for m in measurements], showfliers=False)
        axes.set_xticklabels([str(m.objects) for m in measurements])
        axes.set(
            xlabel="objects",
            ylabel="CPU time [ms]",
            title=title,
        )
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=120)


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("motion_benchmark", Arguments, run, __doc__, words)
