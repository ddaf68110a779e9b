"""Hands on a handle and bases before it, drawn at random; and a place at which an arm that cannot drive is bolted."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from irm import ArmChain, ExactSolver
from irm.answers import YES
from planners.collision.world import CollisionWorld
from planners.scene import Body, Scene

Array = NDArray[np.float64]

_DISTANCES = (0.25, 1.4)
"""[m] from the hand to the middle of the base."""
_STILL = 1e-3
"""[m] Range of a lift that counts as none."""
_CHUNK, _CHUNKS = 500, 20
"""Hands that are looked at together, and how often."""


class NoPlace(RuntimeError):
    """The arm reaches a handle from none of the places drawn."""


def on_pedestal(robot: RobotSpec, rng: np.random.Generator) -> RobotSpec:
    """A robot whose lift stands for good at a height drawn from its range: the arm is on a pedestal."""
    lift, *arm = robot.chain
    height = float(rng.uniform(lift.lower, lift.upper - _STILL))
    still = lift._replace(lower=height, upper=height + _STILL)
    return replace(robot, chain=(still, *arm), home=(height, *robot.home[1:]))


def bolted(scene: Scene, handle: Body, opened: float, rng: np.random.Generator) -> Array:
    """(3,) x, y [m], yaw [rad] of a base from which the joints reach a handle with one hand, shut and opened.

    Exact inverse kinematics says so, whatever the arm would touch; the base itself, with the arm at home, touches
    nothing.

    Args:
        scene: with the robot, which drives in it.
        handle: the body to hold, of what opens and is named "it".
        opened: [m] or [rad] to which it is to be opened.
        rng: for the draws.

    Raises:
        NoPlace: nothing was found.
    """
    robot, opening = scene.robot, scene.opening("it")
    world, solver = CollisionWorld.from_scene(scene), ExactSolver(ArmChain.from_robot(robot))
    drawn = hands(handle, opening.direction(handle.position), robot, rng)
    for _ in range(_CHUNKS):
        some = list(itertools.islice(drawn, _CHUNK))
        ends = [opening.motion(position) for position in (opening.position, opened)]
        reached = np.ones(_CHUNK, dtype=bool)
        for end in ends:
            reached &= solver.reach(np.array([np.linalg.inv(placed(base)) @ end @ T for T, base in some]))[0] == YES
        for row in np.flatnonzero(reached):
            if not world.hits(some[row][1], robot.home, robot.max_opening):
                return some[row][1]
    raise NoPlace(f"of {_CHUNK * _CHUNKS} places none is free with {handle.name} within reach")


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


def placed(base: Array) -> Array:
    """(4, 4) pose of a base (3,) in the world."""
    T = np.eye(4)
    T[:3, :3] = _about(2, base[2])
    T[:2, 3] = base[:2]
    return T


def _about(axis: int, angle: float) -> Array:
    """(3, 3) rotation about one of the axes."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i] = R[j, j] = np.cos(angle)
    R[i, j], R[j, i] = -np.sin(angle), np.sin(angle)
    return R
