"""Task planners on the same problems, and in whole solves: CPU times, plan lengths, clearances.

    python scripts/task_planners.py                                         # what comes with the package
    pip install unified-planning up-fast-downward                           # GPL; into an environment of your own
    python scripts/task_planners.py --engines kairos astar fast-downward fast-downward:ff

Problems: the target waits for so many of 40 objects, or each of these for the next one. Solves: obstructed scenes of
the layout "paper", level grasps. CPU times count child processes, the program of Fast Downward among them.
"""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import tyro

import clutter_env  # noqa: F401  registers the environments
from assets import FETCH
from clutter_env.reporting.tables import markdown_table
from planners import Planner, Scene, Solution
from planners.clock import cpu_seconds
from planners.symbolic.engines import answer_of, task_planner
from planners.symbolic.problem import GRIPPER, NoPlan, TaskProblem
from planners.symbolic.transitions import GraspObstructed, initial_state, update_from_error

_OBJECTS = 40
_PLANNING_S = 60.0
"""[s] of wall time for one problem."""


def chain_of_obstacles(count: int, is_star: bool) -> TaskProblem:
    """The target's grasp is obstructed by `count` objects, or by the first of a row in which each obstructs the one
    before."""
    names = [f"object_{k:02d}" for k in range(_OBJECTS)]
    target, *others = names[: count + 1]
    state = initial_state(names, {}, (GRIPPER,), "")
    row = [target, *others]
    blockers = {target: set(others)} if is_star else {a: {b} for a, b in zip(row, others, strict=False)}
    for name, found in blockers.items():
        state = update_from_error(state, GraspObstructed(name, frozenset(found)))
    return TaskProblem(state, target).pruned()


def problem_row(engine: str, counts: tuple[int, ...], repeats: int) -> list[str]:
    """Median CPU time [ms] of each problem, with the length of the plan."""
    planner, row = task_planner(engine), [engine]
    for count in counts:
        for is_star in (True, False):
            problem, spent = chain_of_obstacles(count, is_star), []
            for _ in range(repeats):
                start = cpu_seconds()
                answer = answer_of(planner, problem, _PLANNING_S)
                spent.append(cpu_seconds() - start)
            length = answer.reason if isinstance(answer, NoPlan) else str(len(answer.actions))
            row.append(f"{1e3 * np.median(spent):.1f} ({length})")
    return row


def solve_rows(engines: tuple[str, ...], objects: int, scenes: int, seed: int) -> list[list[str]]:
    """Of each engine: scenes solved, clearances, calls, CPU time of a call [ms] and of a solve [s], medians."""
    env = gym.make(f"clutter_env/Retrieve-o{objects}-v0", obstructed=True)
    inner, planners = env.unwrapped, {}
    for engine in engines:
        planners[engine] = Planner(FETCH, engine=engine, grasps="side")
        planners[engine].warmup()
    totals = {engine: [0, 0, 0] for engine in engines}
    times: dict[str, list[tuple[float, float]]] = {engine: [] for engine in engines}
    for k in range(scenes):
        _, info = env.reset(seed=seed + k)
        for engine, planner in planners.items():
            scene = Scene.from_mujoco(inner.model, inner.data, inner.robot)  # type: ignore[attr-defined]  # Gymnasium
            found = planner.solve(scene, info["target"], rng=np.random.default_rng(0))
            stats, total = found.stats, totals[engine]
            if isinstance(found, Solution):
                total[0] += 1
                total[1] += len(found.clearances)
                total[2] += stats.task_plans
                times[engine].append((stats.task_planning_s / max(1, stats.task_plans), stats.total_s))
    rows = []
    for engine, (solved, cleared, calls) in totals.items():
        call, whole = np.median(times[engine], axis=0)
        row = [str(objects), engine, f"{solved} of {scenes}", str(cleared), str(calls)]
        rows.append([*row, f"{1e3 * call:.1f}", f"{whole:.2f}"])
    return rows


def main(
    engines: tuple[str, ...] = ("kairos", "astar"),
    obstacles: tuple[int, ...] = (1, 3, 6, 10),
    repeats: int = 5,
    objects: tuple[int, ...] = (15, 40),
    scenes: int = 20,
    seed: int = 744_000,
) -> None:
    """Measure, and print two tables.

    Args:
        engines: names of task planners.
        obstacles: how many objects the target waits for, of each problem.
        repeats: of each problem; the median counts.
        objects: numbers of objects of the scenes.
        scenes: of each number of objects.
        seed: of the first scene.
    """
    head = ["task planner", *(f"{k} {shape}" for k in obstacles for shape in ("around", "in a row"))]
    print("CPU time of a problem [ms], and actions of its plan:\n")
    print(markdown_table(head, [problem_row(engine, obstacles, repeats) for engine in engines]))
    head = ["objects", "task planner", "solved", "clearances", "calls", "a call [CPU ms]", "a solve [CPU s]"]
    print(markdown_table(head, [row for count in objects for row in solve_rows(engines, count, scenes, seed)]))


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
