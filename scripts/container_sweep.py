"""Containers drawn at random, and something put into each in physics: what ended inside, what was refused, and why.

    python -m scripts.container_sweep --cases 20 --out sweep.jsonl

Boxes and round bowls, 8 to 25 cm wide, with walls of 3 to 15 cm that are upright or lean outward, free or standing
fast, turned anyhow, 0.72 m high on a table; cans and boxes that fit in. A case counts as inside if the goal holds when
the plan has been carried out.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import tyro

from assets import RobotSpec, robot as find_robot
from clutter_env.reporting.files import JsonLines
from planners import Scene, Solution, execute, goals, solve, warmup
from scripts.small_worlds import simulated

_TABLE = 0.72
"""[m] its height."""
_ROOM = 0.012
"""[m] that the inside is wider than the object at least."""


@dataclass(frozen=True)
class Arguments:
    """So many `cases` from `seed` on, with a `robot`; rows are written to `out`."""

    cases: int = 20
    seed: int = 0
    robot: str = "fetch"
    out: Path | None = None
    time_limit: float = 60.0
    """[s] of wall time for one solve."""


@dataclass(frozen=True)
class Case:
    """A container and an object.

    Attributes:
        kind: "box" or "round".
        is_free: whether the container may be moved.
        width, length: [m] inside, at the floor; of a round one both are the diameter.
        walls: [m] height above the floor.
        slope: [rad] by which the walls of a round one lean outward.
        x, y, yaw: [m], [rad] where it stands.
        thing: "cylinder" or "box".
        half_width, half_height: [m] of the object.
    """

    kind: str
    is_free: bool
    width: float
    length: float
    walls: float
    slope: float
    x: float
    y: float
    yaw: float
    thing: str
    half_width: float
    half_height: float


def drawn(seed: int) -> Case:
    """The case of a seed."""
    rng = np.random.default_rng(seed)
    kind = str(rng.choice(["box", "round"]))
    width, length = map(float, rng.uniform(0.08, 0.25, 2))
    length = length if kind == "box" else width
    thing = str(rng.choice(["cylinder", "box"]))
    widest = (min(width, length) - _ROOM) / 2
    widest = widest / math.sqrt(2) if thing == "box" and kind == "round" else widest
    return Case(
        kind,
        bool(rng.random() < 0.5),
        width,
        length,
        float(rng.uniform(0.03, 0.15)),
        float(rng.uniform(0.0, 0.4)) * (kind == "round"),
        float(rng.uniform(0.9, 1.1)),
        float(rng.uniform(0.05, 0.25)),
        float(rng.uniform(-math.pi, math.pi)),
        thing,
        float(min(rng.uniform(0.018, 0.036), widest)),
        float(rng.uniform(0.03, 0.07)),
    )


def _walls_of(case: Case) -> str:
    """The geoms of a container, in its frame."""
    thick, bottom, a, b, half = 0.004, 0.008, case.width / 2, case.length / 2, case.walls / 2
    box = '<geom type="box" size="{} {} {}" pos="{} {} {}" euler="0 {} {}" mass="0.05"/>'
    if case.kind == "box":
        sides = [(thick, b + 2 * thick, s * (a + thick), 0.0) for s in (1, -1)]
        sides += [(a, thick, 0.0, s * (b + thick)) for s in (1, -1)]
        floor = box.format(a + 2 * thick, b + 2 * thick, bottom / 2, 0, 0, bottom / 2, 0, 0)
        return floor + "".join(box.format(x, y, half, u, v, bottom + half, 0, 0) for x, y, u, v in sides)
    count, lean = 16, math.tan(case.slope)
    parts = f'<geom type="cylinder" size="{a + thick} {bottom / 2}" pos="0 0 {bottom / 2}" mass="0.2"/>'
    out = a + thick / 2 + lean * half
    wide = (out + lean * half + thick) * math.tan(math.pi / count)
    for turn in np.arange(count) * 2 * math.pi / count:
        at = out * math.cos(turn), out * math.sin(turn), bottom + half
        parts += box.format(thick / 2, wide, half / math.cos(case.slope), *at, case.slope, turn)
    return parts


def model_of(case: Case) -> str:
    """The MJCF of a case."""
    joint, size = "<freejoint/>", f"{case.half_width} {case.half_height}"
    size = size if case.thing == "cylinder" else f"{case.half_width} {size}"
    return f"""<mujoco><compiler angle="radian" eulerseq="XYZ"/><worldbody>
      <geom name="floor" type="plane" size="0 0 1"/>
      <body pos="1.1 0 {_TABLE / 2}"><geom name="table" type="box" size="0.35 0.5 {_TABLE / 2}"/></body>
      <body name="container" pos="{case.x} {case.y} {_TABLE + 0.0001}" euler="0 0 {case.yaw}">
        {joint * case.is_free}{_walls_of(case)}</body>
      <body name="thing" pos="1.0 -0.25 {_TABLE + case.half_height + 0.0001}">{joint}
        <geom type="{case.thing}" size="{size}" mass="0.15"/></body>
    </worldbody></mujoco>"""


def put_into(case: Case, robot: RobotSpec, time_limit: float) -> dict[str, object]:
    """What became of a case: whether the object is inside in the end, or why it was refused."""
    model, data = simulated(model_of(case), robot)
    movable = ["thing", *(["container"] if case.is_free else [])]

    def seen() -> Scene:
        return Scene.from_mujoco(model, data, robot, movable=movable, support="table")

    scene, goal, before = seen(), goals.inside("thing", "container"), time.process_time()
    plan = solve(scene, goal, time_limit=time_limit, rng=np.random.default_rng(0))
    row: dict[str, object] = {"solve_s": time.process_time() - before}
    if not isinstance(plan, Solution):
        return {**row, "refused": str(plan.cause), "detail": plan.detail}
    done, after = execute(plan, model, data), seen()
    before_after = [one.body("container").position for one in (scene, after)] if case.is_free else [np.zeros(3)] * 2
    return {
        **row,
        "is_inside": goal.holds(after, scene),
        "is_upright": after.body("thing").is_upright,
        "moved_mm": 1000 * float(np.linalg.norm(before_after[1] - before_after[0])),
        "deviation": str(done.deviation or ""),
    }


def main(arguments: Arguments) -> None:
    """Try all cases, and print a line for each and a table."""
    robot = find_robot(arguments.robot)
    warmup(robot)
    counts: Counter[str] = Counter()
    times = []
    for seed in range(arguments.seed, arguments.seed + arguments.cases):
        case = drawn(seed)
        row = put_into(case, robot, arguments.time_limit)
        outcome = "refused" if "refused" in row else ("inside" if row["is_inside"] else "failed")
        counts[outcome] += 1
        counts["inside and upright"] += outcome == "inside" and bool(row["is_upright"])
        times.append(float(str(row["solve_s"])))
        print(seed, outcome, asdict(case), row, flush=True)
        if arguments.out is not None:
            JsonLines(arguments.out).append({"seed": seed, **asdict(case), **row})
    print(dict(counts), f"planning: median {np.median(times):.2f} s, 95% {np.quantile(times, 0.95):.2f} s")


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
