"""Handles that the planner says are out of reach: is there any way to hold them? Looked for without the planner.

    python -m scripts.opening_sweep --cases 100 --seed 1000 --out sweep.jsonl
    python -m scripts.opening_refusals sweep.jsonl

Hands and bases are drawn at random, in many more directions than the planner's grasps have; exact inverse kinematics
says which of them the arm reaches, and the collision check, which of its configurations touch nothing. A refusal counts
as confirmed if none does at any of `--poses` of them.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from numpy.typing import NDArray

from assets import RobotSpec, robot as find_robot
from irm import ArmChain, ExactSolver, all_solutions, free_angles
from irm.answers import YES
from planners import Scene
from planners.collision.world import CollisionWorld
from planners.opening.handle import with_handle
from planners.scene import Body
from scripts.opening_sweep import Case, model_of
from scripts.small_worlds import simulated

Array = NDArray[np.float64]

_TORSOS, _ANGLES = 5, 48
"""Heights of the lift, and angles of the free joint, at which configurations are looked for."""
_DISTANCES = (0.25, 1.4)
"""[m] from the hand to the middle of the base."""
_MOST = 3000
"""Hands reached by the joints whose configurations are checked for contact."""


@dataclass(frozen=True)
class Arguments:
    """The `sweep` whose refusals are looked at, with its `robot`; how many `poses` of hand and base are drawn."""

    sweep: Annotated[Path, tyro.conf.Positional]
    robot: str = "fetch"
    differential: bool = False
    poses: int = 60_000


def hands(handle: Body, outwards: Array, robot: RobotSpec, rng: np.random.Generator) -> Iterator[tuple[Array, Array]]:
    """Poses (4, 4) of a hand that holds a handle, and bases (3,) from which the arm may reach it."""
    longest = int(np.argmax(handle.half_extents))
    along = handle.rotation[:, longest] * handle.half_extents[longest]
    inwards = np.arctan2(-outwards[1], -outwards[0])
    while True:
        yaw, pitch, roll = inwards + rng.uniform(-1.4, 1.4), rng.uniform(-0.4, np.pi / 2), rng.uniform(-np.pi, np.pi)
        T = np.eye(4)
        T[:3, :3] = _about(2, yaw) @ _about(1, pitch) @ _about(0, roll)
        T[:3, 3] = handle.position + rng.uniform(-0.7, 0.7) * along
        width = handle.width_in_gripper(np.linalg.inv(T) @ handle.pose)
        if width + robot.finger_gap > robot.max_opening:
            continue
        turn, bearing = inwards + rng.uniform(-1.6, 1.6), rng.uniform(-1.0, 1.0)
        distance = rng.uniform(*_DISTANCES)
        x, y = T[:2, 3] - distance * np.array((np.cos(turn + bearing), np.sin(turn + bearing)))
        yield T, np.array((x, y, turn))


def _about(axis: int, angle: float) -> Array:
    """(3, 3) rotation about one of the axes."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i] = R[j, j] = np.cos(angle)
    R[i, j], R[j, i] = -np.sin(angle), np.sin(angle)
    return R


def held_somehow(case: Case, robot: RobotSpec, poses: int) -> dict[str, int]:
    """How many of so many poses the joints reach, how many of these are checked, and how many are free."""
    model, data = simulated(model_of(case), robot)
    scene = Scene.from_mujoco(model, data, robot, movable=(), support="floor")
    opening = scene.opening("it")
    twin = with_handle(scene, "it", opening.at_share(0.8), opening.handles)
    assert twin is not None
    assert twin.pull is not None
    handle, ignored = twin.body(twin.pull.handle), twin.mask([twin.pull.handle])
    world, chain = CollisionWorld.from_scene(twin), ArmChain.from_robot(robot)
    drawn = list(
        itertools.islice(hands(handle, opening.direction(handle.position), robot, np.random.default_rng(0)), poses)
    )
    is_free = [not world.hits(base, robot.home, robot.max_opening, ignore=ignored) for _, base in drawn]
    relative = np.array([np.linalg.inv(_placed(base)) @ T for T, base in drawn])
    status, _ = ExactSolver(chain).reach(relative)
    rows = np.flatnonzero((status == YES) & is_free)
    torsos = np.linspace(chain.lower[0], chain.upper[0], _TORSOS if chain.upper[0] > chain.lower[0] else 1)
    angles = free_angles(chain, _ANGLES)
    free = 0
    for row in rows[:: max(len(rows) // _MOST, 1)]:
        T, base = drawn[row]
        width = handle.width_in_gripper(np.linalg.inv(T) @ handle.pose)
        opened = min(width + 2 * robot.finger_gap, robot.max_opening)
        found = all_solutions(chain, relative[row], torsos, angles)
        free += bool(len(found)) and not np.all(world.hits_many(base, found, opened, ignore=ignored))
    return {"reached": len(rows), "checked": len(rows[:: max(len(rows) // _MOST, 1)]), "free": free}


def _placed(base: Array) -> Array:
    """(4, 4) pose of a base (3,) in the world."""
    T = np.eye(4)
    T[:3, :3] = _about(2, base[2])
    T[:2, 3] = base[:2]
    return T


def main(arguments: Arguments) -> None:
    """Print a line for every refused case, and how many are confirmed."""
    robot = find_robot(arguments.robot)
    robot = robot.differential() if arguments.differential else robot
    rows = [json.loads(line) for line in arguments.sweep.read_text().splitlines()]
    refused = [row for row in rows if "refused" in row]
    confirmed = 0
    for row in refused:
        case = Case(**{one.name: row[one.name] for one in fields(Case)})
        found = held_somehow(case, robot, arguments.poses)
        confirmed += not found["free"]
        print(row["seed"], case.kind, case.handle, f"{case.height:.2f} m", row["refused"], found, flush=True)
    print(f"{len(refused)} refused, {confirmed} confirmed")


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
