"""Handles that the planner says are out of reach: is there any way to hold them? Looked for without the planner.

    python -m scripts.opening_sweep --cases 100 --seed 1000 --out sweep.jsonl
    python -m scripts.opening_refusals sweep.jsonl

Hands and bases are drawn at random, in many more directions than the planner's grasps have; exact inverse kinematics
says which of them the arm reaches, and the collision check, which of its configurations touch nothing. A refusal counts
as confirmed if none does at any of `--poses` of them. Of a robot on a `--pedestal` the hand must hold the handle
all the way, from where the robot stands.
"""

from __future__ import annotations

import itertools
import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from assets import RobotSpec, robot as find_robot
from irm import ArmChain, ExactSolver, all_solutions, free_angles
from irm.answers import YES
from planners import Scene
from planners.collision.world import CollisionWorld
from planners.opening.handle import with_handle
from planners.scene.moving import moved
from scripts.opening_places import hands, placed
from scripts.opening_sweep import OPEN, Case, model_of, stood
from scripts.small_worlds import BASE, simulated

_TORSOS, _ANGLES = 5, 48
"""Heights of the lift, and angles of the free joint, at which configurations are looked for."""
_PLACES = 5
"""Of the way of what opens at which an arm on a pedestal must hold the handle."""
_MOST = 3000
"""Hands reached by the joints whose configurations are checked for contact."""


@dataclass(frozen=True)
class Arguments:
    """The `sweep` whose refusals are looked at, with its `robot`; how many `poses` of hand and base are drawn."""

    sweep: Annotated[Path, tyro.conf.Positional]
    robot: str = "fetch"
    differential: bool = False
    pedestal: bool = False
    poses: int = 60_000


def held_somehow(case: Case, robot: RobotSpec, base: tuple[float, ...] | None, poses: int) -> dict[str, int]:
    """How many of so many poses the joints reach, how many of these are checked, and how many are free.

    A robot that drives may hold the handle from any base. One that stands at a `base`, (x, y, yaw), must hold it with
    the same hand at some places of its way, from shut to open.
    """
    scene = Scene.from_mujoco(*simulated(model_of(case), robot, base or BASE), robot, movable=(), support="floor")
    opening, chain = scene.opening("it"), ArmChain.from_robot(robot)
    positions = np.linspace(opening.position, opening.at_share(OPEN), _PLACES if base else 1)
    worlds = [_held(scene, position) for position in positions]
    twin = worlds[0].scene
    assert twin.pull is not None
    handle, ignored = twin.body(twin.pull.handle), twin.mask([twin.pull.handle])
    outwards, rng = opening.direction(handle.position), np.random.default_rng(0)
    drawn = list(itertools.islice(hands(handle, outwards, robot, rng), poses))
    if base:
        drawn = [(T, np.array(base)) for T, _ in drawn]
    reached = np.array(
        [bool(base) or not worlds[0].hits(at, robot.home, robot.max_opening, ignore=ignored) for _, at in drawn]
    )
    relative = []
    for position in positions:
        relative.append(np.array([np.linalg.inv(placed(at)) @ opening.motion(position) @ T for T, at in drawn]))
        reached &= ExactSolver(chain).reach(relative[-1])[0] == YES
    rows = np.flatnonzero(reached)
    torsos = np.linspace(chain.lower[0], chain.upper[0], 1 if base else _TORSOS)
    angles = free_angles(chain, _ANGLES)
    checked, free = rows[:: max(len(rows) // _MOST, 1)], 0
    for row in checked:
        T, at = drawn[row]
        width = handle.width_in_gripper(np.linalg.inv(T) @ handle.pose)
        opened = min(width + 2 * robot.finger_gap, robot.max_opening)
        found = (all_solutions(chain, there[row], torsos, angles) for there in relative)
        free += all(
            bool(len(Q)) and not np.all(world.hits_many(at, Q, opened, ignore=ignored))
            for world, Q in zip(worlds, found, strict=True)
        )
    return {"reached": len(rows), "checked": len(checked), "free": free}


def _held(scene: Scene, position: float) -> CollisionWorld:
    """The scene with what opens at a position, and its handle among the objects."""
    there = moved(scene, "it", position)
    opening = there.opening("it")
    twin = with_handle(there, "it", opening.at_share(OPEN), opening.handles)
    assert twin is not None
    return CollisionWorld.from_scene(twin)


def main(arguments: Arguments) -> None:
    """Print a line for every refused case, and how many are confirmed."""
    robot = find_robot(arguments.robot)
    robot = robot.differential() if arguments.differential else robot
    rows = [json.loads(line) for line in arguments.sweep.read_text().splitlines()]
    refused = [row for row in rows if "refused" in row]
    confirmed = 0
    for row in refused:
        case = Case(**{one.name: row[one.name] for one in fields(Case)})
        standing, base = stood(case, robot, row["seed"]) if arguments.pedestal else (robot, None)
        found = held_somehow(case, standing, base, arguments.poses)
        confirmed += not found["free"]
        print(row["seed"], case.kind, case.handle, f"{case.height:.2f} m", row["refused"], found, flush=True)
    print(f"{len(refused)} refused, {confirmed} confirmed")


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
