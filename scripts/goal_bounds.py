"""The lower bound in geometry: is it ever above the best plan of a long search, in small scenes?

    python scripts/goal_bounds.py run outputs/bounds.jsonl
    python scripts/goal_bounds.py table outputs/bounds.jsonl
    python scripts/goal_bounds.py again outputs/bounds.jsonl
    python scripts/goal_bounds.py one 49100017

Two to four objects stand close together on a table or under a board, and one is to be taken, or some are to be moved.
Every strategy plans, the one that looks ahead with many more tries than usual and several seeds: the fewest picks of
all these plans stand beside the bound. A bound above them is wrong, and so is a proof that there is no plan. `run` goes
on where it ended; `again` works out the bounds of a file anew, and prints the table with its plans.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any
from unittest.mock import patch

import numpy as np
import tyro
from numpy.typing import NDArray

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.reporting.files import JsonLines
from clutter_env.reporting.progress import progress_bar
from planners import STRATEGIES, Region, Scene, Solution, goals, lower_bound, solve, warmup
from planners.goals import Goal

FIRST_SEED = 49_100_000
LAYOUTS = ("paper", "dense", "two_tables", "shelf", "cabinet", "two_boards")
OBJECTS = ("standard", "household")
GAPS = (0.004, 0.05)
"""[m] between the circles about neighbours."""
EDGE = 0.02
"""[m] from the circle about an object to the edge of the table at least."""
SEEDS = 3
"""Plans of the long search; one of every other strategy."""
LONG = replace(STRATEGIES["lookahead"], tries=1000, attempts=6)


@dataclass(frozen=True)
class Run:
    """Plan for the scenes that a file lacks."""

    out: tyro.conf.Positional[Path]
    """File of JSON lines."""
    scenes: int = 200
    budget: float = 20.0
    """[s] of CPU time for one solve."""
    minutes: float = 60.0
    """[min] of wall time after which no scene is begun."""


@dataclass(frozen=True)
class Table:
    """Print what a file holds: a row for each goal, and each bound that is wrong."""

    file: tyro.conf.Positional[Path]


@dataclass(frozen=True)
class Again:
    """Print the same with the bounds as they are now, and the plans of the file."""

    file: tyro.conf.Positional[Path]


@dataclass(frozen=True)
class One:
    """Plan for one scene, and print what is known of it."""

    seed: tyro.conf.Positional[int]
    budget: float = 20.0


def main(command: Run | Table | Again | One) -> None:
    """Do what is asked."""
    match command:
        case Run():
            run(command)
        case Table(file):
            report(JsonLines(file).values)
        case Again(file):
            warmup()
            report([row | bound_of(row["seed"]) for row in progress_bar(JsonLines(file).values)])
        case One(seed, budget):
            print(measure(seed, budget))


def run(arguments: Run) -> None:
    """Measure scene after scene, and print the table."""
    file, started = JsonLines(arguments.out), time.monotonic()
    known = {row["seed"] for row in file.values}
    warmup()
    for seed in progress_bar([seed for k in range(arguments.scenes) if (seed := FIRST_SEED + k) not in known]):
        if time.monotonic() - started > 60 * arguments.minutes:
            break
        file.append(measure(seed, arguments.budget))
    report(file.values)


def measure(seed: int, budget: float) -> dict[str, Any]:
    """One line: the bound, and the picks of the best plan of all, None without one."""
    kind, layout, objects, scene, goal = drawn(seed)
    found = {name: picks for name, picks in plans(scene, goal, budget) if picks is not None}
    best = min(found, key=lambda name: found[name], default="")
    return {
        "seed": seed,
        "goal": kind,
        "layout": layout,
        "objects": objects,
        "count": len(scene.objects),
        "pddl": str(goal),
        **bound_of(seed),
        "best": found.get(best),
        "by": best,
    }


def bound_of(seed: int) -> dict[str, Any]:
    """What the bound says of a scene."""
    *_, scene, goal = drawn(seed)
    bound = lower_bound(scene, goal)
    return {"picks": bound.picks, "least": bound.least, "proved": bound.proved, "cause": bound.cause}


def plans(scene: Scene, goal: Goal, budget: float) -> Sequence[tuple[str, int | None]]:
    """The picks of every plan that is tried, None for a refusal; deadlines count CPU time."""
    found = list[tuple[str, int | None]]()
    others = [strategy for name, strategy in STRATEGIES.items() if name != LONG.name]
    for strategy, seed in [(LONG, seed) for seed in range(SEEDS)] + [(other, 0) for other in others]:
        with patch.object(time, "monotonic", time.process_time):
            outcome = solve(scene, goal, strategy, seed, budget)
        picks = None
        if isinstance(outcome, Solution):
            assert outcome.end is not None
            assert not goal.unmet(outcome.end, scene)
            picks = outcome.picks
        found.append((f"{strategy.name} {seed}", picks))
    return found


# Scenes: functions of the seed alone.


def drawn(seed: int) -> tuple[str, str, str, Scene, Goal]:
    """Kind of goal, layout, set of objects, scene and goal of a seed."""
    rng = np.random.default_rng(seed)
    kind, layout, objects = str(rng.choice([*GOALS])), str(rng.choice(LAYOUTS)), str(rng.choice(OBJECTS))
    count = int(rng.integers(3 if kind == "stack" else 2, 5))
    env = RetrieveEnv(num_objects=count, layout=layout, object_set=objects)
    while True:
        env.reset(seed=int(rng.integers(2**31)))
        scene = drawn_together(rng, Scene.from_mujoco(env.model, env.data, env.robot))
        names = [str(name) for name in rng.permutation(scene.names)]
        scene, goal = GOALS[kind](scene, names)
        if not goal.holds(scene):
            env.close()
            return kind, layout, objects, scene, goal


def drawn_together(rng: np.random.Generator, scene: Scene) -> Scene:
    """The scene with its objects close together, somewhere on the first support."""
    face = scene.support
    while True:
        middles = list[NDArray[np.float64]]()
        radii = [float(np.hypot(*body.half_extents[:2])) for body in scene.objects]
        for number, radius in enumerate(radii):
            reach = face.extent[:2] - radius - EDGE
            for _ in range(100):
                if number:
                    beside, angle = int(rng.integers(number)), rng.uniform(-np.pi, np.pi)
                    away = radius + radii[beside] + rng.uniform(*GAPS)
                    middle = middles[beside] + away * np.array((np.cos(angle), np.sin(angle)))
                else:
                    middle = face.position[:2] + rng.uniform(-1.0, 1.0, 2) * reach
                apart = (
                    np.hypot(*(middle - other)) >= radius + r + GAPS[0]
                    for other, r in zip(middles, radii, strict=False)
                )
                if (np.abs(middle - face.position[:2]) <= reach).all() and all(apart):
                    middles.append(middle)
                    break
        if len(middles) == len(radii):
            break
    for body, middle in zip(scene.objects, middles, strict=True):
        scene = scene.with_body(body.at([*middle, body.position[2] - body.bottom + face.top]))
    return scene


def _at(scene: Scene, name: str, other: str) -> Goal:
    """An object where another one stands."""
    return goals.at(name, scene.body(other).position[:2])


def _take(scene: Scene, names: list[str]) -> tuple[Scene, Goal]:
    return scene, goals.holding(names[0])


def _swap(scene: Scene, names: list[str]) -> tuple[Scene, Goal]:
    return scene, goals.and_(*(_at(scene, *pair) for pair in zip(names, (*names[1:], names[0]), strict=True)))


def _replace(scene: Scene, names: list[str]) -> tuple[Scene, Goal]:
    return scene, _at(scene, names[0], names[1])


def _region(scene: Scene, names: list[str]) -> tuple[Scene, Goal]:
    middle, half = scene.body(names[1]).position[:2], 0.02 + float(np.hypot(*scene.body(names[0]).half_extents[:2]))
    region = Region("place", scene.support.name, (float(middle[0]), float(middle[1])), (half, half))
    return replace(scene, regions=(region,)), goals.inside(names[0], "place")


def _clear(scene: Scene, names: list[str]) -> tuple[Scene, Goal]:
    middle = scene.body(names[0]).position[:2]
    region = Region("place", scene.support.name, (float(middle[0]), float(middle[1])), (0.09, 0.09))
    return replace(scene, regions=(region,)), goals.clear("place")


def _away(scene: Scene, names: list[str]) -> tuple[Scene, Goal]:
    return scene, goals.and_(*(goals.on(name, "counter_left") for name in names[:2]))


def _order(scene: Scene, names: list[str]) -> tuple[Scene, Goal]:
    scene, goal = _away(scene, names)
    return scene, goal & goals.before(names[0], names[1])


def _hold(scene: Scene, names: list[str]) -> tuple[Scene, Goal]:
    return scene, _at(scene, names[0], names[1]) & goals.holding(names[1])


def _stack(scene: Scene, names: list[str]) -> tuple[Scene, Goal]:
    return scene, goals.on(names[0], names[1]) & goals.on(names[1], names[2])


GOALS: dict[str, Callable[[Scene, list[str]], tuple[Scene, Goal]]] = {
    "take": _take,
    "swap": _swap,
    "replace": _replace,
    "region": _region,
    "clear": _clear,
    "away": _away,
    "order": _order,
    "hold": _hold,
    "stack": _stack,
}
"""What is wanted, for a scene and its objects in a random order."""


# The table.


def report(rows: Sequence[dict[str, Any]]) -> None:
    """Print a row for each kind of goal, and what is wrong or open."""
    columns = ("goal", "scenes", "planned", "bound too high", "proved", "proved and met", "best / bound", "no plan")
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|")
    for kind in (*GOALS, "all"):
        if some := [row for row in rows if kind in (row["goal"], "all")]:
            print(f"| {kind} | {' | '.join(_cells(some))} |")
    for row in rows:
        if _is_wrong(row):
            print(f"  too high: {_name(row)}: {row['least']} {row['cause']} for {row['best']} by {row['by']}")
        elif row["proved"] and row["best"] is not None and row["best"] > row["picks"]:
            print(f"  proved, not met: {_name(row)}: {row['picks']} for {row['best']} by {row['by']}")
    for row in rows:
        if row["best"] is None and not (row["picks"] is None and row["proved"]):
            print(f"  no plan, no proof: {_name(row)}: {row['pddl']}")


def _cells(rows: Sequence[dict[str, Any]]) -> Sequence[str]:
    done = [row for row in rows if row["best"] is not None]
    proved = [row for row in done if row["proved"]]
    best, least = sum(row["best"] for row in done), sum(row["least"] for row in done)
    ratios = [row["best"] / row["least"] for row in done if row["least"]]
    none = Counter("proved" if row["proved"] and row["picks"] is None else "open" for row in rows if row not in done)
    return (
        str(len(rows)),
        str(len(done)),
        str(sum(map(_is_wrong, rows))),
        str(len(proved)),
        str(sum(row["best"] == row["picks"] for row in proved)),
        f"{best} / {least}, mean {np.mean(ratios):.3f}" if ratios else "none",
        f"{none['proved']} proved, {none['open']} open",
    )


def _is_wrong(row: dict[str, Any]) -> bool:
    """Whether there is a plan with fewer picks than the bound, or one though it is proved that there is none."""
    if row["best"] is None:
        return False
    return bool(row["best"] < row["least"] or (row["picks"] is None and row["proved"]))


def _name(row: dict[str, Any]) -> str:
    return f"{row['seed']} {row['goal']} {row['layout']} {row['objects']} {row['count']}"


if __name__ == "__main__":
    main(
        tyro.cli(
            Annotated[Run, tyro.conf.subcommand("run")]
            | Annotated[Table, tyro.conf.subcommand("table")]
            | Annotated[Again, tyro.conf.subcommand("again")]
            | Annotated[One, tyro.conf.subcommand("one")],
            description=__doc__,
        )
    )
