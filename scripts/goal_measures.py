"""Goals in unseen scenes: tasks × layouts × object sets, one after another, and where plans fall short.

    python scripts/goal_measures.py run outputs/goals.jsonl
    python scripts/goal_measures.py table outputs/goals.jsonl
    python scripts/goal_measures.py one 49000017

`run` writes one JSON line a scene, and goes on where it ended. A scene is known by its seed: that gives its task, its
layout, its objects and its goal. `one` plans for a scene again and prints the summary. Planning has a budget of CPU
time, so that a busy machine changes nothing. To measure another checkout: PYTHONPATH=DIR.

"proved": the bound proves that there is no plan. "refused": the planner says so without such a proof. A plan is "wrong"
if a fact of the goal does not hold at its end, by geometry, or its order is not kept.
"""

from __future__ import annotations

import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any, NamedTuple
from unittest.mock import patch

import gymnasium
import numpy as np
import tyro
from numpy.typing import NDArray

import clutter_env
from clutter_env.reporting.files import JsonLines
from clutter_env.reporting.progress import progress_bar
from clutter_env.scene.layout import LAYOUTS, SECOND_TABLE, TABLE, TABLE_HEIGHT, Layout, supports_of, tray
from clutter_env.scene.object_sets import OBJECT_SETS, capacity
from planners import Cause, Infeasible, Region, Scene, Solution, goals, lower_bound, solve, warmup
from planners.clock import cpu_seconds
from planners.goals import Goal

STATES = ("planned", "proved", "refused", "given up", "time limit", "wrong", "error")
TASKS = ("sort", "set", "swap", "stack", "fetch", "clear")
GROUPS = {"tables": ("paper", "dense", "two_tables"), "under boards": ("shelf", "cabinet", "two_boards")}
OBJECTS = ("standard", "household")
NOT_DRAWN = {("fetch", "paper"): 'with the second table that "fetch" needs, "paper" is "two_tables"'}
"""Tasks that a layout does not have, and why."""
CASES = [
    (task, layout, objects)
    for objects, layout, task in product(OBJECTS, (name for names in GROUPS.values() for name in names), TASKS)
    if (task, layout) not in NOT_DRAWN
]
FIRST_SEED = 49_000_000
"""No suite, no training and no test has seeds near it."""
LEAST, MOST, MOST_CLEARED = 4, 12, 6
"""Objects of a scene, and of one whose first support is to be cleared."""
_MOVED = 3
"""Objects that stand on a second support that is to be cleared."""
_APART = 0.10
"""[m] between objects that are put on a second support, beyond their radii, and from its edge half of that."""
_SUNK = 0.005
"""[m] that the foot of an object may be off the face on which it stands: contacts are soft."""
_COUNTER_MIDDLE = 0.3
"""[m] from the table's edge to the middle of the counter beside it, where a tray stands."""


class Measured(NamedTuple):
    """A scene, and the goal in it."""

    seed: int
    task: str
    layout: str
    objects: str
    scene: Scene
    goal: Goal


class Opened(NamedTuple):
    """The reset environment of a seed; what "clear" asks for, in place of its goal, follows from `clears` and `rng`."""

    env: Any
    task: str
    layout: str
    objects: str
    clears: str
    rng: np.random.Generator


@dataclass(frozen=True)
class Run:
    """Plan for the scenes that a file lacks."""

    out: tyro.conf.Positional[Path]
    """File of JSON lines."""
    scenes: int = 200
    first: int = FIRST_SEED
    budget: float = 10.0
    """[s] of CPU time for one solve."""
    minutes: float = 35.0
    """[min] of wall time after which no scene is begun."""


@dataclass(frozen=True)
class Table:
    """Print what files hold: a row for each task and group of layouts, and each scene that falls short."""

    files: tyro.conf.Positional[tuple[Path, ...]]


@dataclass(frozen=True)
class One:
    """Plan for one scene, and print the summary."""

    seed: tyro.conf.Positional[int]
    budget: float = 10.0
    """[s] of CPU time."""


def main(command: Run | Table | One) -> None:
    """Do what is asked."""
    match command:
        case Run():
            run(command)
        case Table(files):
            report([row for file in files for row in JsonLines(file).values])
        case One(seed, budget):
            show(seed, budget)


def run(arguments: Run) -> None:
    """Measure scene after scene, and print the table."""
    file, started = JsonLines(arguments.out), time.monotonic()
    known = {row["seed"] for row in file.values}
    warmup()
    for seed in progress_bar(
        [arguments.first + k for k in range(arguments.scenes) if arguments.first + k not in known]
    ):
        if time.monotonic() - started > 60 * arguments.minutes:
            break
        file.append(measure(drawn(seed), arguments.budget))
    report(file.values)


def show(seed: int, budget: float) -> None:
    """Plan for a scene, and print goal, bound and answer."""
    it = drawn(seed)
    print(
        f"{it.task} {it.layout} {it.objects}, {len(it.scene.objects)} objects; supports {', '.join(it.scene.supports)}"
    )
    print(it.goal)
    print(lower_bound(it.scene, it.goal))
    found, cpu_s = solved(it, budget)
    print(found.summary())
    if isinstance(found, Solution):
        assert found.end is not None
        print(f"takes: {', '.join(taken(found))}; unmet: {it.goal.unmet(found.end, it.scene) or 'nothing'}")
    print(f"{cpu_s:.2f} s of CPU time, the last attempt's replans: {found.stats.replans}")


def measure(it: Measured, budget: float) -> dict[str, Any]:
    """One line: what came out, and what the bound says; an error of the planner is a result, too."""
    row = {
        "seed": it.seed,
        "task": it.task,
        "layout": it.layout,
        "objects": it.objects,
        "count": len(it.scene.objects),
        "goal": str(it.goal),
    }
    before = cpu_seconds()
    try:
        bound = lower_bound(it.scene, it.goal)
        bound_s = cpu_seconds() - before
        found, cpu_s = solved(it, budget)
    except Exception as error:
        trace = "".join(traceback.format_exception(error)[-3:])
        row |= {"cpu_s": cpu_seconds() - before, "bound": {"picks": None, "least": 0, "proved": False, "cause": ""}}
        return {**row, "status": "error", "cause": type(error).__name__, "detail": f"{error}\n{trace}"}
    row |= {
        "cpu_s": cpu_s,
        "bound_s": bound_s,
        "bound": {"picks": bound.picks, "least": bound.least, "proved": bound.proved, "cause": bound.cause},
    }
    if isinstance(found, Infeasible):
        is_limit, is_proved = found.cause in (Cause.TIME_LIMIT, Cause.GIVEN_UP), bound.picks is None and bound.proved
        status = "proved" if is_proved else str(found.cause) if is_limit else "refused"
        return {**row, "status": status, "cause": found.cause, "detail": found.detail, "replans": found.stats.replans}
    assert found.end is not None
    unmet, is_in_order = it.goal.unmet(found.end, it.scene), it.goal.is_in_order(taken(found))
    return {
        **row,
        "status": "planned" if is_in_order and not unmet else "wrong",
        "picks": found.picks,
        "takes": taken(found),
        "unmet": [str(Goal((fact,))) for fact in unmet],
        "replans": found.stats.replans,
    }


def solved(it: Measured, budget: float) -> tuple[Solution | Infeasible, float]:
    """The answer of the planner, whose deadline counts CPU time here, and the CPU time [s] that it took."""
    before = cpu_seconds()
    with patch.object(time, "monotonic", time.process_time):
        found = solve(it.scene, it.goal, time_limit=budget)
    return found, cpu_seconds() - before


def taken(found: Solution) -> list[str]:
    """Names of the objects that a plan takes, in order."""
    return [action.target for action in found.actions if action.name == "PickUp"]


# Scenes: functions of the seed alone.


def drawn(seed: int) -> Measured:
    """The scene of a seed, and the goal."""
    env, task, name, objects, clears, rng = opened(seed)
    inner = env.unwrapped
    scene = Scene.from_mujoco(inner.model, inner.data, inner.robot, regions=inner.regions)
    goal = inner.goal
    env.close()
    if clears:
        scene, goal = CLEARED[clears](rng, scene)
    return Measured(seed, task if not clears else f"clear {clears}", name, objects, scene, goal)


def opened(seed: int) -> Opened:
    """The environment of a seed after its reset."""
    task, name, objects = CASES[(seed - FIRST_SEED) % len(CASES)]
    rng, layout = np.random.default_rng(seed), _layout(task, name)
    clears = str(rng.choice(["region", "first", "second"])) if task == "clear" else ""
    own: dict[str, Any] = {"object_set": objects} if objects != "standard" else {}
    most = MOST_CLEARED if clears == "first" else MOST
    count = int(rng.integers(LEAST, min(most, capacity(layout, "cylinder", OBJECT_SETS[objects])) + 1))
    env = gymnasium.make(
        "clutter_env/Rearrange-o8-v0",
        max_episode_steps=clutter_env.rearrange_time_limit(count),
        num_objects=count,
        task=task if task != "clear" else "swap",
        layout=layout,
        **own,
    )
    # The goal of "clear" is not one of the environment's: any other one lets it put the objects down.
    env.reset(seed=seed, options={"goal": f"(on object_00 {TABLE})"} if clears else None)
    return Opened(env, task, name, objects, clears, rng)


def _layout(task: str, name: str) -> Layout:
    """The layout with what the task needs: trays on the counters, or a second table in the next room."""
    layout = LAYOUTS[name]
    if task == "sort":
        y = layout.width / 2 + _COUNTER_MIDDLE
        trays = (*tray("red", 0.0, y), *tray("blue", 0.0, -y))
        stands = [one for one in supports_of(layout) if not one.startswith("counter")]
        return replace(layout, boxes=(*layout.boxes, *trays), supports=(*stands, "tray_red", "tray_blue"))
    if task == "fetch" and SECOND_TABLE not in supports_of(layout):
        room = LAYOUTS["two_tables"].boxes
        return replace(layout, boxes=(*layout.boxes, *room), supports=(*supports_of(layout), SECOND_TABLE))
    return layout


def _clear_region(rng: np.random.Generator, scene: Scene) -> tuple[Scene, Goal]:
    """A rectangle of the table about one of the objects that stand there."""
    on_table = [one for one in scene.objects if one.bottom < TABLE_HEIGHT + _SUNK]
    middle = on_table[rng.integers(len(on_table))].position[:2]
    half = rng.uniform((0.08, 0.10), (0.16, 0.22))
    region = Region("place", TABLE, (float(middle[0]), float(middle[1])), (float(half[0]), float(half[1])))
    return replace(scene, regions=(region,)), goals.clear("place")


def _clear_first(rng: np.random.Generator, scene: Scene) -> tuple[Scene, Goal]:  # noqa: ARG001  as of the others
    return scene, goals.clear(TABLE)


def _clear_second(rng: np.random.Generator, scene: Scene) -> tuple[Scene, Goal]:
    """The shelf's upper board, the table in the next room, or a counter; but for the board, objects are put there."""
    name = next(one for one in ("shelf_board", SECOND_TABLE, "counter_left") if one in scene.supports)
    face = scene.support_named(name)
    there: list[tuple[NDArray[np.float64], float]] = []
    for body in scene.objects[: _MOVED if name != "shelf_board" else 0]:
        radius = float(np.hypot(*body.half_extents[:2]))
        reach = face.extent[:2] - radius - _APART / 2
        for _ in range(1000):
            point = face.position[:2] + rng.uniform(-1.0, 1.0, 2) * reach
            if all(np.hypot(*(point - other)) > radius + r + _APART for other, r in there):
                break
        else:
            raise RuntimeError(f"no room on {name} for {body.name}")
        there.append((point, radius))
        scene = scene.with_body(body.at([*point, body.position[2] + face.top - body.bottom]))
    return scene, goals.clear(name)


CLEARED: dict[str, Callable[[np.random.Generator, Scene], tuple[Scene, Goal]]] = {
    "region": _clear_region,
    "first": _clear_first,
    "second": _clear_second,
}
"""What "clear" asks for."""


# The table.


def report(rows: Sequence[dict[str, Any]]) -> None:
    """Print a row for each task and group of layouts, sums, and what falls short."""
    columns = ("task", "layouts", "scenes", *STATES, "picks / least", "CPU s")
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|")
    for task in TASKS:
        for group in GROUPS:
            _print_row(f"{task} | {group}", [row for row in rows if _is_in(row, task=task, group=group)])
    for objects, group in product(OBJECTS, GROUPS):
        _print_row(f"{objects} | {group}", [row for row in rows if _is_in(row, objects=objects, group=group)])
    _print_row("all | all", rows)
    for (task, layout), why in NOT_DRAWN.items():
        print(f"not drawn: {task} × {layout}: {why}")
    short = [row for row in rows if row["status"] not in ("planned", "proved")]
    print(f"\n{len(short)} fall short:")
    for row in sorted(short, key=lambda row: (row["status"], row["task"], row["layout"])):
        bound = row["bound"]
        least = f"bound {bound['least']}{' proved' * bound['proved']}" if bound["picks"] is not None else "no bound"
        words = f"unmet {row['unmet']}" if row["status"] == "wrong" else f"{row['cause']}: {row['detail']}"
        print(f"  {_name(row)}: {row['status']}; {least}; {row['cpu_s']:.1f} s; {words}")
    proofs = [row for row in rows if row["status"] == "proved"]
    print(f"\n{len(proofs)} proved impossible:")
    for row in sorted(proofs, key=lambda row: (row["task"], row["layout"])):
        print(f"  {_name(row)}: {row['cause']}: {row['detail']}")
    more = [row for row in rows if row["status"] == "planned" and row["picks"] > row["bound"]["least"]]
    print(f"\n{len(more)} plans with more picks than the bound:")
    for row in sorted(more, key=lambda row: row["bound"]["least"] - row["picks"]):
        proved = "" if row["bound"]["proved"] else " (not proved)"
        print(f"  {_name(row)}: {row['picks']} for {row['bound']['least']}{proved}; {row['cpu_s']:.1f} s")
    below = [row for row in rows if row["status"] == "planned" and row["picks"] < row["bound"]["least"]]
    print(f"\n{len(below)} plans with fewer picks than the bound: {', '.join(map(_name, below)) or 'none'}")


def _print_row(head: str, rows: Sequence[dict[str, Any]]) -> None:
    if not rows:
        print(f"| {head} | 0 |{' |' * (len(STATES) + 2)}")
        return
    counts, done = Counter(row["status"] for row in rows), [row for row in rows if row["status"] == "planned"]
    picks, least = sum(row["picks"] for row in done), sum(row["bound"]["least"] for row in done)
    states = [counts[name] for name in STATES]
    median, late = np.quantile([row["cpu_s"] for row in rows], (0.5, 0.95))
    ratio = f"{picks} / {least} = {picks / least:.2f}" if least else "none"
    print(f"| {head} | {len(rows)} | {' | '.join(map(str, states))} | {ratio} | {median:.2f}, 95% {late:.2f} |")


def _is_in(row: dict[str, Any], task: str = "", group: str = "", objects: str = "") -> bool:
    is_task, is_group = not task or row["task"].split()[0] == task, not group or row["layout"] in GROUPS[group]
    return is_task and is_group and objects in ("", row["objects"])


def _name(row: dict[str, Any]) -> str:
    return f"{row['seed']} {row['task']} {row['layout']} {row['objects']} {row['count']}"


if __name__ == "__main__":
    main(
        tyro.cli(
            Annotated[Run, tyro.conf.subcommand("run")]
            | Annotated[Table, tyro.conf.subcommand("table")]
            | Annotated[One, tyro.conf.subcommand("one")],
            description=__doc__,
        )
    )
