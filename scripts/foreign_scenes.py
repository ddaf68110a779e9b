"""Scenes out of other people's packages, as they are, with a robot of this project put in: planned and executed.

    pip install gymnasium-robotics
    pip download --no-deps dm_control robosuite==1.5.2 -d wheels   # their models alone are needed: unzip both
    python scripts/foreign_scenes.py --packages wheels

Each line says what `prepare` changed and what came of the plan; what is refused, and why.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import gymnasium_robotics
import mujoco
import numpy as np
import tyro

import assets
from planners import ExpertError, Goal, Scene, SceneError, Solution, execute, insert_robot, prepare, solve


@dataclass(frozen=True)
class Arguments:
    """Plan and execute in other people's scenes."""

    packages: Path = Path("wheels")
    """Folder in which the wheels of dm_control and robosuite were unpacked."""
    only: str = ""
    """Part of the name of the scenes to try; all if not given."""


class Case(NamedTuple):
    """A scene of a package and what is wanted in it.

    Attributes:
        file: of the scene; `objects` are files of objects that are put into it, with their places x, y, z [m].
        base: x, y [m], yaw [rad] of our robot; `without` are the bodies that are left out, another robot above all.
        places: where free bodies of the file are put, x, y, z [m]; their own environment does it by code.
    """

    file: str
    goal: str
    movable: tuple[str, ...]
    support: str
    base: tuple[float, float, float]
    without: tuple[str, ...] = ()
    places: dict[str, tuple[float, float, float]] = {}  # noqa: RUF012  never written
    objects: dict[str, tuple[float, float, float]] = {}  # noqa: RUF012  never written
    robot: str = "fetch"


_FETCH = ("robot0:mocap", "robot0:base_link")
_BINS = {
    "can": (0.05, -0.35, 0.88),
    "milk": (0.15, -0.15, 0.905),
    "cereal": (0.0, -0.12, 0.92),
    "bread": (0.2, -0.4, 0.86),
}
CASES = {
    "gymnasium-robotics pick_and_place": Case(
        "gym/fetch/pick_and_place.xml",
        "object0",
        ("object0",),
        "table0",
        (0.4, 0.75, 0.0),
        _FETCH,
        {"object0": (1.2, 0.7, 0.425)},
    ),
    "gymnasium-robotics slide": Case(
        "gym/fetch/slide.xml",
        "object0",
        ("object0",),
        "table0",
        (0.0, 0.75, 0.0),
        _FETCH,
        {"object0": (0.9, 0.9, 0.42)},
    ),
    "gymnasium-robotics kitchen": Case(
        "gym/kitchen_franka/kitchen_assets/kitchen_env_model.xml",
        "kettle",
        ("kettle",),
        "counters",
        (-0.3, -1.0, 1.57),
        ("panda0_link0",),
    ),
    "gymnasium-robotics adroit_relocate": Case(
        "gym/adroit_hand/adroit_relocate.xml", "Object", ("Object",), "table", (-1.0, 0.0, 0.0), ("forearm",)
    ),
    "robosuite bins, fetch": Case(
        "robosuite/robosuite/models/assets/arenas/bins_arena.xml",
        "can",
        tuple(_BINS),
        "bin1",
        (-0.8, -0.25, 0.0),
        objects=_BINS,
    ),
    "robosuite bins, milk to the other bin": Case(
        "robosuite/robosuite/models/assets/arenas/bins_arena.xml",
        "(on milk bin2)",
        tuple(_BINS),
        "bin1",
        (-0.8, -0.25, 0.0),
        objects=_BINS,
        robot="panda_mobile",
    ),
    "robosuite table": Case(
        "robosuite/robosuite/models/assets/arenas/table_arena.xml",
        "bottle",
        ("bottle", "lemon", "square-nut"),
        "table",
        (-0.9, 0.0, 0.0),
        objects={"bottle": (0.0, 0.0, 0.9), "lemon": (0.1, 0.2, 0.85), "square-nut": (-0.1, -0.2, 0.83)},
    ),
    "gymnasium-robotics push": Case(
        "gym/fetch/push.xml",
        "object0",
        ("object0",),
        "table0",
        (0.55, 0.75, 0.0),
        _FETCH,
        {"object0": (1.2, 0.75, 0.425)},
        robot="panda_mobile",
    ),
    "gymnasium-robotics manipulate_block": Case(
        "gym/hand/manipulate_block.xml", "object", ("object",), "floor", (0.3, 0.87, 0.0), ("robot0:hand mount",)
    ),
    "gymnasium-robotics adroit_hammer": Case(
        "gym/adroit_hand/adroit_hammer.xml", "Object", ("Object",), "table", (-1.0, 0.0, 0.0), ("forearm",)
    ),
    "dm_control manipulator": Case(
        "dm_control/dm_control/suite/manipulator.xml", "ball", ("ball",), "floor", (-1.0, 0.0, 0.0), ("upper_arm",)
    ),
    "dm_control stacker": Case(
        "dm_control/dm_control/suite/stacker.xml", "box0", ("box0",), "floor", (-1.0, 0.0, 0.0), ("upper_arm",)
    ),
}


def main(arguments: Arguments) -> None:
    """Print a line for each scene."""
    for name, case in CASES.items():
        if arguments.only in name:
            print(f"| {name} | {case.robot} | {case.goal} | {outcome(case, arguments.packages)} |", flush=True)


def outcome(case: Case, packages: Path) -> str:
    """What came of it, in three columns: changed, planned, executed."""
    robot, changed = assets.robot(case.robot), "–"
    try:
        fit = prepare(insert_robot(_with_objects(case, packages), robot, case.base, without=case.without), robot)
        kinds = Counter(" ".join(change.what.split()[:2]) for change in fit.changes)
        changed = ", ".join(f"{count} × {what}" if count > 1 else what for what, count in kinds.items()) or "nothing"
        model, data = fit.model, mujoco.MjData(fit.model)
        for joint, value in zip(robot.drive_joints[3:], robot.home, strict=True):
            data.joint(joint).qpos = value
        for body, place in case.places.items():
            data.joint(int(model.body(body).jntadr[0])).qpos[:3] = place
        _settle(model, data, robot)
        more = [word.strip("()") for word in case.goal.split()[2:]]
        scene = Scene.from_mujoco(model, data, robot, movable=case.movable, support=case.support, more_supports=more)
        before = time.process_time()
        goal = Goal.from_pddl(case.goal.replace(more[0], scene.supports[1])) if more else case.goal
        solution = solve(scene, goal, rng=np.random.default_rng(0), time_limit=300.0)
        if not isinstance(solution, Solution):
            return f"{changed} | no: {solution.cause}: {solution.detail} | –"
        planned = f"{len(solution.actions)} actions, {time.process_time() - before:.1f} CPU s"
        result = execute(solution, model, data)
        return f"{changed} | {planned} | {'yes' if result.finished else result.deviation}"
    except (SceneError, ExpertError, ValueError) as problem:
        return f"{changed} | refused: {problem} | –"


def _with_objects(case: Case, packages: Path) -> mujoco.MjSpec:
    """The scene with its objects, each on a free joint, under its own name."""
    if case.file.startswith("gym/"):
        file = Path(gymnasium_robotics.__file__).parent / "envs" / "assets" / case.file.removeprefix("gym/")
    else:
        file = packages / case.file
    spec = mujoco.MjSpec.from_file(str(file))
    for name, place in case.objects.items():
        one = mujoco.MjSpec.from_file(str(file.parents[1] / "objects" / f"{name}.xml"))
        body = spec.worldbody.add_frame(pos=place).attach_body(one.worldbody.first_body(), f"{name}/", "")
        body.name = name
        body.add_freejoint()
    return spec


def _settle(model: mujoco.MjModel, data: mujoco.MjData, robot: assets.RobotSpec) -> None:
    """Let what was put above its support come to rest; the robot holds its configuration."""
    drive = robot.drive_joints
    data.ctrl[[model.actuator(name).id for name in drive]] = [data.joint(name).qpos[0] for name in drive]
    mujoco.mj_step(model, data, nstep=round(1.0 / model.opt.timestep))


if __name__ == "__main__":
    main(tyro.cli(Arguments))
