"""Drawers and doors drawn at random, opened in physics: which were, which were refused, and why.

    python -m scripts.opening_sweep --cases 100 --out sweep.jsonl
    python -m scripts.opening_sweep --cases 40 --robot panda_mobile --pedestal

Handles of 8 to 30 mm, bars (upright or level) and round knobs, of friction 0.2 to 20 N (of doors N m over the width);
drawers at 0.2 to 1.2 m height, doors of 0.3 to 0.7 m that open to the left and to the right. A case counts as opened
if, when the plan has been carried out, it is open by 0.8 of its range. With `--pedestal` the robot drives nowhere: it
stands where its arm, by its joints alone, reaches the handle shut and open, its lift at a height drawn too.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import tyro

from assets import RobotSpec, robot as find_robot
from clutter_env.reporting.files import JsonLines
from planners import Scene, Solution, execute, goals, solve, warmup
from planners.opening.handle import with_handle
from scripts.opening_places import NoPlace, bolted, on_pedestal
from scripts.small_worlds import BASE, simulated

OPEN = 0.8
"""Share of its range from which on something counts as opened."""
_TRAVEL, _SWING = 0.28, 95.0
"""[m] and [degrees] that drawers and doors go."""


@dataclass(frozen=True)
class Arguments:
    """So many `cases` from `seed` on, with a `robot`; rows are written to `out`."""

    cases: int = 100
    seed: int = 0
    robot: str = "fetch"
    differential: bool = False
    pedestal: bool = False
    out: Path | None = None
    time_limit: float = 60.0
    """[s] of wall time for one solve."""


@dataclass(frozen=True)
class Case:
    """One piece of furniture.

    Attributes:
        kind: "drawer", "left" or "right": where the hinge of a door is, seen from the front.
        handle: "upright", "level" or "knob".
        thickness: [m] of the handle.
        stands_out: [m] of its middle from the front.
        height: [m] of the middle of the front.
        width: [m] of the front.
        friction: [N] at the handle.
    """

    kind: str
    handle: str
    thickness: float
    stands_out: float
    height: float
    width: float
    friction: float


def drawn(seed: int) -> Case:
    """The case of a seed."""
    rng = np.random.default_rng(seed)
    kind = str(rng.choice(["drawer", "left", "right"], p=[0.5, 0.25, 0.25]))
    height = rng.uniform(0.2, 1.2) if kind == "drawer" else rng.uniform(0.5, 1.1)
    return Case(
        kind,
        str(rng.choice(["upright", "level", "knob"])),
        float(rng.uniform(0.008, 0.030)),
        float(rng.uniform(0.04, 0.07)),
        float(height),
        float(rng.uniform(0.3, 0.7) if kind != "drawer" else rng.uniform(0.3, 0.6)),
        float(np.exp(rng.uniform(np.log(0.2), np.log(20.0)))),
    )


def model_of(case: Case) -> str:
    """The MJCF of a case, its front at x = 0.9 m."""
    half, bar = case.thickness / 2, 0.05
    shapes = {
        "upright": f'type="box" size="{half} {half} {bar}"',
        "level": f'type="box" size="{half} {bar} {half}"',
        "knob": f'type="cylinder" size="{max(half, 0.008)} 0.012" euler="0 90 0"',
    }
    friction = 'friction="1 0.01 0.001"'
    stem = f'<geom type="box" size="{case.stands_out / 2} 0.004 0.004" pos="{case.stands_out / 2} 0 0" mass="0.02"/>'
    handle = f'<geom name="handle" {shapes[case.handle]} mass="0.1" {friction}/>{stem}'
    w, z = case.width / 2, case.height
    sides = "".join(
        f'<geom type="box" size="0.2 0.01 {(z + 0.2) / 2}" pos="0.22 {side * (w + 0.015)} {(z + 0.2) / 2}"/>'
        for side in (-1, 1)
    )
    if case.kind == "drawer":
        joint = f'<joint type="slide" axis="-1 0 0" range="0 {_TRAVEL}" damping="5" frictionloss="{case.friction}"/>'
        parts = (
            f'<geom name="front" type="box" size="0.01 {w} 0.08" mass="0.5"/>'
            f'<geom name="bottom" type="box" size="0.16 {w - 0.01} 0.005" pos="0.17 0 -0.07" mass="0.5"/>'
        )
        at = f"-{case.stands_out} 0 0"
        body = f'<body name="it" pos="0.9 0 {z}">{joint}{parts}<body pos="{at}">{handle}</body></body>'
    else:
        side = 1 if case.kind == "left" else -1
        torque = case.friction * (case.width - 0.05)
        joint = f'<joint type="hinge" axis="0 0 {-side}" range="0 {_SWING}" damping="1" frictionloss="{torque}"/>'
        panel = f'<geom name="front" type="box" size="0.01 {w} 0.17" pos="0 {-side * w} 0" mass="1.5"/>'
        at = f"-{case.stands_out} {-side * (case.width - 0.05)} 0"
        body = f'<body name="it" pos="0.9 {side * w} {z}">{joint}{panel}<body pos="{at}">{handle}</body></body>'
    cabinet = f'<body name="cabinet" pos="0.9 0 0">{sides}</body>'
    return f'<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/>{cabinet}{body}</worldbody></mujoco>'


def stood(case: Case, robot: RobotSpec, seed: int) -> tuple[RobotSpec, tuple[float, ...]]:
    """A robot on a pedestal before a case, and where it stands: x, y [m], yaw [rad]."""
    rng = np.random.default_rng(seed)
    robot = on_pedestal(robot, rng)
    scene = Scene.from_mujoco(*simulated(model_of(case), robot), robot, movable=(), support="floor")
    opening = scene.opening("it")
    twin = with_handle(scene, "it", opening.at_share(OPEN), opening.handles)
    assert twin is not None
    assert twin.pull is not None
    x, y, yaw = bolted(twin, twin.body(twin.pull.handle), twin.pull.position, rng)
    return robot.fixed(), (float(x), float(y), float(yaw))


def opened(case: Case, robot: RobotSpec, base: tuple[float, ...], time_limit: float) -> dict[str, object]:
    """What became of a case: its share in the end, or why it was refused."""
    model, data = simulated(model_of(case), robot, base)
    scene = Scene.from_mujoco(model, data, robot, movable=(), support="floor")
    before = time.process_time()
    plan = solve(scene, goals.open_("it"), time_limit=time_limit)
    row: dict[str, object] = {"solve_s": time.process_time() - before}
    if not isinstance(plan, Solution):
        return {**row, "refused": str(plan.cause), "detail": plan.detail}
    done = execute(plan, model, data)
    after = Scene.from_mujoco(model, data, robot, movable=(), support="floor")
    return {**row, "share": after.opening("it").share, "deviation": str(done.deviation or ""), "sim_s": done.sim_s}


def main(arguments: Arguments) -> None:
    """Try all cases, and print a line for each and a table."""
    robot = find_robot(arguments.robot)
    robot = robot.differential() if arguments.differential else robot
    warmup(robot)
    counts: Counter[str] = Counter()
    times, skipped = [], []
    for seed in range(arguments.seed, arguments.seed + arguments.cases):
        case = drawn(seed)
        try:
            standing, base = stood(case, robot, seed) if arguments.pedestal else (robot, BASE)
        except NoPlace as problem:
            skipped.append(seed)
            print(seed, problem, flush=True)
            continue
        row = opened(case, standing, base, arguments.time_limit)
        share = row.get("share")
        outcome = "refused" if share is None else ("opened" if float(str(share)) >= OPEN else "failed")
        counts[outcome] += 1
        times.append(float(str(row["solve_s"])))
        print(seed, outcome, asdict(case), row, flush=True)
        if arguments.out is not None:
            JsonLines(arguments.out).append({"seed": seed, **asdict(case), **row})
    if skipped:
        print(len(skipped), "cases left out, out of reach from any pedestal that was drawn")
    print(dict(counts), f"planning: median {np.median(times):.2f} s, 95% {np.quantile(times, 0.95):.2f} s")


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
