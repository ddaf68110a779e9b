"""Other people's tasks, solved through their own `step`: planned, executed, and scored by their own check.

    python scripts/bridge_table.py --python venv-kinder/bin/python --seeds 50 --out outputs/bridges.jsonl
    python scripts/bridge_table.py --tasks FetchPickAndPlace-v4 --seeds 50 --out outputs/bridges.jsonl
    python scripts/bridge_table.py --tasks robosuite/Lift --python venv-robosuite/bin/python --out outputs/bridges.jsonl
    python scripts/bridge_table.py --tasks libero/libero_goal --python venv-libero/bin/python --out outputs/libero.jsonl
    python scripts/bridge_table.py --tasks metaworld/drawer-open --python venv-metaworld/bin/python --out doors.jsonl
    python scripts/bridge_table.py --tasks "kitchen/slide cabinet" --seeds 20 --out doors.jsonl
    python scripts/bridge_table.py --out outputs/bridges.jsonl --show

One line of the file is one episode; episodes that the file has are not run again.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from clutter_env.bridges.fetch_tasks import DOWN, FetchTask
from clutter_env.bridges.kinder_tasks import GRASPS as KINDER_GRASPS, KinderTask
from clutter_env.bridges.kitchen_tasks import BARS, KitchenTask
from clutter_env.bridges.libero_tasks import LIMITS, LiberoTask
from clutter_env.bridges.metaworld_tasks import DOWN as METAWORLD_GRASPS, MetaworldTask
from clutter_env.bridges.remote import BridgeError, Remote
from clutter_env.bridges.robosuite_tasks import RobosuiteTask
from clutter_env.rendering.film import save_gif
from clutter_env.rendering.framing import view_of
from clutter_env.rendering.renderer import Renderer
from clutter_env.reporting.intervals import wilson
from planners import ControlledWorld, ExpertConfig, GoalError, MonitorConfig, SceneError, Solution, TampExpert

KINDER = (
    "kinder/PickPlace3D-o1-v0",
    "kinder/FrankaPickPlace3D-o1-v0",
    "kinder/Shelf3D-o3-v0",
    "kinder/Shelf3D-o8-v0",
    "kinder/SortClutteredBlocks3D-o4-sort_the_cluttered_blocks_into_bins-v0",
    "kinder/Rearrange3D-o1-put_the_boxed_drink_behind_the_bowl-v0",
    "kinder/Rearrange3D-o1-put_the_boxed_drink_in_front_of_the_bowl-v0",
    "kinder/Rearrange3D-o1-put_the_boxed_drink_next_to_the_bowl-v0",
    "kinder/Rearrange3D-o1-put_the_boxed_drink_on_the_left_side_of_the_bowl-v0",
    "kinder/Rearrange3D-o1-put_the_boxed_drink_on_the_right_side_of_the_bowl-v0",
    "kinder/Rearrange3D-o2-put_the_boxed_drink_and_the_can_next_to_the_bowl-v0",
    "kinder/Rearrange3D-o2-put_the_boxed_drink_in_front_of_and_the_can_behind_the_bowl-v0",
    "kinder/Rearrange3D-o2-put_the_boxed_drink_on_the_left_and_the_can_on_the_right_side_of_the_bowl-v0",
    "kinder/Rearrange3D-o2-put_the_can_in_front_of_and_the_boxed_drink_behind_the_bowl-v0",
    "kinder/Rearrange3D-o2-put_the_can_on_the_left_and_the_boxed_drink_on_the_right_side_of_the_bowl-v0",
)

KITCHEN = "kitchen"
"""Package of the ids of FrankaKitchen, which like FetchPickAndPlace needs no other environment."""
SIZE, FRAME_MS, AROUND, ABOVE = (320, 240), 80, 0.25, (0.0, 0.0, 0.8)
"""Pixels of a film, [ms] for which an image is shown, [m] around the objects that are in it, and up the robot."""


@dataclass(frozen=True)
class Arguments:
    """Solve other people's tasks, and print the table."""

    out: Path
    """JSON lines, one an episode."""
    python: Path = Path("venv-kinder/bin/python")
    """Of the environment in which KinDER is installed, or robosuite, LIBERO or MetaWorld."""
    tasks: tuple[str, ...] = KINDER
    """Ids; of LIBERO a suite, `libero/libero_goal`, which is all its tasks, or one of them, `libero/libero_goal/3`."""
    first: int = 0
    """First seed; of LIBERO's frozen initial states."""
    seeds: int = 5
    """How many seeds for each task."""
    steps: int = 8000
    """Episodes end after so many; KinDER's have no limit of their own."""
    planning: float = math.inf
    """[s] of wall time for each plan of LIBERO's tasks."""
    film: Path | None = None
    """Folder for a film of each episode, of the world as the planner sees it."""
    speed: float = 10.0
    """Of the film, in that of the robot."""
    turn: float = 140.0
    """[°] from where the objects are seen by the robot to where the camera looks: 180 is towards the robot."""
    show: bool = False
    """Only print the table."""


def main(arguments: Arguments) -> None:
    """Run the missing episodes in the order of their seeds, and print the table."""
    rows = [json.loads(line) for line in arguments.out.read_text().splitlines()] if arguments.out.exists() else []
    if not arguments.show:
        done = {(row["task"], row["seed"]) for row in rows}
        packages = {task.partition("/")[0] for task in arguments.tasks if "/" in task} - {KITCHEN}
        if len(packages) > 1:
            raise SystemExit(f"tasks of {' and '.join(sorted(packages))} need runs of their own: --python is one")
        if arguments.film:
            arguments.film.mkdir(parents=True, exist_ok=True)
        worker = Remote(arguments.python, f"{packages.pop()}_worker.py") if packages else nullcontext()
        with worker as remote, arguments.out.open("a") as file:
            tasks = [one for id in arguments.tasks for one in tasks_of(remote, id)]
            for seed in range(arguments.first, arguments.first + arguments.seeds):
                for task in tasks:
                    if (task, seed) not in done:
                        rows.append(episode(remote, task, seed, arguments))
                        print(json.dumps(rows[-1]), file=file, flush=True)
    print("\n".join(table(rows)))


def episode(remote: Remote | None, id: str, seed: int, arguments: Arguments) -> dict[str, Any]:
    """One episode: what became of it, the CPU time [s] to the first plan, steps taken."""
    row: dict[str, Any] = {
        "task": id,
        "seed": seed,
        "planned": False,
        "executed": False,
        "scored": False,
        "failure": "",
    }
    try:
        task, choices = begin(remote, id, seed)
        # No limit of wall time, on a busy machine. KinDER's base lags where its yaw passes half a turn.
        config = ExpertConfig(planning_s=math.inf, with_floor=False, monitor=MonitorConfig(base=0.25))
        if isinstance(task, LiberoTask):
            config = replace(task.config, planning_s=arguments.planning)
        expert = TampExpert(task.world, **choices, config=config)
        before = time.process_time()
        expert.reset()
    except (SceneError, GoalError, BridgeError) as problem:
        return {**row, "failure": f"scene: {problem}"}
    row |= {"cpu": time.process_time() - before, "planned": isinstance(expert.solution, Solution)}
    look = Camera(task.world, arguments.speed, arguments.turn) if arguments.film else None
    while not (expert.done or task.world.is_over) and task.steps < arguments.steps:
        task.world.step(expert.act())
        if look:
            look()
        # At rest, and the environment's own check counts.
        if not isinstance(task, FetchTask) and task.is_solved and not expert.phase:
            break
    if arguments.film and look:
        save_gif(look.images, arguments.film / f"{id.rpartition('/')[2]}-{seed}.gif", FRAME_MS)
    report = expert.report
    if isinstance(task, FetchTask):
        task.finish()
    limits: dict[str, Any] = {}
    if isinstance(task, LiberoTask):  # its evaluations end where the check first holds
        limits = {"limit": task.limit, "solved_at": task.solved_at, "at_end": task.is_solved}
    return row | {
        "executed": report.executed or task.is_solved,
        "scored": task.is_solved or limits.get("solved_at") is not None,
        "failure": report.failure,
        "replans": report.replans,
        "deviations": list(report.deviations),
        "steps": task.steps,
        **limits,
    }


class Camera:
    """Films a controlled world: robot and objects where they are at first, and regions of the goal."""

    def __init__(self, world: ControlledWorld, speed: float, turn: float) -> None:
        self._world, self._interval, self.images = world, speed * FRAME_MS / 1000, list[NDArray[np.uint8]]()
        self._renderer = Renderer(world.model, *SIZE)
        objects = np.array([world.data.body(name).xpos for name in world.object_names])
        robot = world.data.body(world.robot.base_body).xpos
        ahead = objects.mean(axis=0) - robot
        around = AROUND * np.array(list(product((-1, 1), repeat=3)))
        goals = [(*region.centre, robot[2]) for region in world.regions]
        points = (np.vstack((objects, robot + ABOVE, *goals))[:, None] + around).reshape(-1, 3)
        direction = float(np.degrees(np.arctan2(ahead[1], ahead[0]))) + turn, -30
        self._view = view_of(world.model, points, direction, SIZE[0] / SIZE[1])

    def __call__(self) -> None:
        """Take an image, if it is time for one."""
        if self._world.data.time > len(self.images) * self._interval:
            self.images.append(self._renderer.colour(self._world.data, self._view))


def begin(remote: Remote | None, id: str, seed: int) -> tuple[Any, dict[str, Any]]:
    """An episode of the package that the id names, and what the expert plans with."""
    package, _, rest = id.partition("/")
    if package == KITCHEN:
        return KitchenTask(rest, seed), {"grasps": BARS}
    if remote is None:
        return FetchTask(seed, id), {"grasps": DOWN}
    name, *robot = rest.split("/")
    if package == "libero":
        libero = LiberoTask(remote, name, int(robot[0]), seed)
        return libero, {"planner": libero.planner}
    if package == "metaworld":
        return MetaworldTask(remote, name, seed), {"grasps": METAWORLD_GRASPS}
    if package == "robosuite":
        task = RobosuiteTask(remote, name, seed, *robot)
        return task, {"planner": task.planner}
    return KinderTask(remote, id, seed), {"grasps": KINDER_GRASPS}


def tasks_of(remote: Remote | None, id: str) -> tuple[str, ...]:
    """A suite of LIBERO is all its tasks."""
    package, _, suite = id.partition("/")
    if remote is None or package != "libero" or "/" in suite:
        return (id,)
    return tuple(f"{id}/{number}" for number, _ in enumerate(remote("tasks", suite=suite)["tasks"]))


def table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Lines of Markdown, one for each task."""
    yield "| task | seeds | planned | executed | scored | 95% | first plan, CPU s (median) | steps (median) | replans |"
    yield "| --- | --- | --- | --- | --- | --- | --- | --- | --- |"
    for task in dict.fromkeys(row["task"] for row in rows):
        own = [row for row in rows if row["task"] == task]
        counts = " | ".join(str(sum(row[key] for row in own)) for key in ("planned", "executed", "scored"))
        played = [row for row in own if "steps" in row]
        numbers = " | ".join(f"{median(row[key] for row in played):.3g}" if played else "" for key in ("cpu", "steps"))
        _, low, high = wilson(sum(row["scored"] for row in own), len(own))
        share = f"{low:.0%} to {high:.0%}"
        yield f"| {task} | {len(own)} | {counts} | {share} | {numbers} | {sum(row['replans'] for row in played)} |"
    yield from libero_table(rows)


def libero_table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Lines of Markdown, one for each suite of LIBERO and each kind of LIBERO-PRO's variants of them.

    They count what was scored at all, and before evaluations of policies end.
    """
    suites = dict.fromkeys(suite_of(row["task"]) for row in rows if row["task"].startswith("libero/"))
    if suites:
        yield ""
        yield "| suite | episodes | planned | executed | scored | scored within | first plan, CPU s (median) | steps |"
        yield "| --- | --- | --- | --- | --- | --- | --- | --- |"
    for suite in suites:
        own = [row for row in rows if row["task"].startswith("libero/") and suite_of(row["task"]) == suite]
        counts = " | ".join(str(sum(row[key] for row in own)) for key in ("planned", "executed", "scored"))
        solved = [row for row in own if row["scored"] and row["solved_at"] is not None]
        within = sum(row["limit"] is not None and row["solved_at"] <= row["limit"] for row in solved)
        limits = {row["limit"] for row in solved}
        steps_at_most = f" ({limits.pop()} steps)" if len(limits) == 1 else ""
        numbers = f"{median([row['cpu'] for row in own if 'cpu' in row] or [math.nan]):.3g}"
        steps = f"{median([row['solved_at'] for row in solved] or [math.nan]):.3g}"
        yield f"| `{suite}` | {len(own)} | {counts} | {within}{steps_at_most} | {numbers} | {steps} |"


def suite_of(task: str) -> str:
    """A suite of LIBERO; all suites that one kind of variant of LIBERO-PRO is of count as one."""
    suite = task.split("/")[1]
    known = max((name for name in LIMITS if suite.startswith(name)), key=len, default="")
    return suite if known in ("", suite) else f"LIBERO-PRO: {suite.removeprefix(f'{known}_')}"


if __name__ == "__main__":
    main(tyro.cli(Arguments))
