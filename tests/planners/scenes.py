"""Random table-top scenes without any simulation, and the maps and planners that several test files share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from assets.robots import FETCH
from planners.scene import Body, RobotState, Scene, StaticObstacle

DEPTH, WIDTH, HEIGHT = 0.7, 1.0, 0.75
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])

OBSTACLES = (
    StaticObstacle("table_top", np.array([0.0, 0.0, HEIGHT - 0.02]), np.array([DEPTH / 2, WIDTH / 2, 0.02])),
    StaticObstacle("counter_left", np.array([0.0, 0.8, 0.375]), np.array([DEPTH / 2, 0.3, 0.375])),
    StaticObstacle("counter_right", np.array([0.0, -0.8, 0.375]), np.array([DEPTH / 2, 0.3, 0.375])),
    StaticObstacle("wall", np.array([0.37, 0.0, 0.8]), np.array([0.02, 1.1, 0.8])),
)


def wall(name: str, start: tuple[float, float], end: tuple[float, float]) -> StaticObstacle:
    """A wall 0.1 m thick and 2 m high, along x or y."""
    middle, half = np.add(start, end) / 2, np.abs(np.subtract(end, start)) / 2
    return StaticObstacle(name, np.array([*middle, 1.0]), np.array([*np.maximum(half, 0.05), 1.0]))


ROOM = (
    wall("back", (-4.5, -2.0), (-4.5, 2.0)),
    wall("left", (-4.5, 2.0), (-1.8, 2.0)),
    wall("right", (-4.5, -2.0), (-1.8, -2.0)),
    wall("front_left", (-1.8, 0.45), (-1.8, 2.0)),
    wall("front_right", (-1.8, -2.0), (-1.8, -0.45)),
)
"""A room beside the table, its door 0.9 m wide."""


def cylinder(name: str, x: float, y: float, radius: float = 0.03, height: float = 0.16) -> Body:
    """An upright cylinder on the table."""
    half = np.array([radius, radius, height / 2])
    return Body(name, "cylinder", half, np.array([x, y, HEIGHT + height / 2]), UPRIGHT)


def table_scene(*objects: Body) -> Scene:
    """The robot at home in front of a table with these objects."""
    state = RobotState(np.array([-1.1, 0.0, 0.0]), np.array(FETCH.home), FETCH.max_finger_position)
    return Scene(FETCH, state, objects, OBSTACLES)


def random_scene(count: int, seed: int) -> Scene:
    """`count` cylinders at random places, 12 mm apart at least."""
    rng = np.random.default_rng(seed)
    objects: list[Body] = []
    while len(objects) < count:
        radius, height = rng.uniform(0.025, 0.035), rng.uniform(0.12, 0.20)
        x, y = rng.uniform(-DEPTH / 2 + 0.05, DEPTH / 2 - 0.05), rng.uniform(-WIDTH / 2 + 0.05, WIDTH / 2 - 0.05)
        apart = (np.hypot(o.position[0] - x, o.position[1] - y) > radius + o.radius + 0.012 for o in objects)
        if all(apart):
            objects.append(cylinder(f"object_{len(objects):02d}", x, y, radius, height))
    return table_scene(*objects)


PANEL = 0.01
BOARD_HEIGHT = 0.4
SHELF = (
    StaticObstacle(
        "shelf_board",
        np.array([0.0, 0.0, HEIGHT + BOARD_HEIGHT + PANEL]),
        np.array([DEPTH / 2, WIDTH / 2 + 2 * PANEL, PANEL]),
    ),
    *(
        StaticObstacle(
            f"shelf_{name}",
            np.array([0.0, side * (WIDTH / 2 + PANEL), HEIGHT + BOARD_HEIGHT / 2]),
            np.array([DEPTH / 2, PANEL, BOARD_HEIGHT / 2]),
        )
        for name, side in (("left", 1), ("right", -1))
    ),
)


def shelf_scene(*objects: Body) -> Scene:
    """The robot at home, farther away than from the open table, before a shelf with these objects."""
    scene = table_scene(*objects)
    state = RobotState(np.array([-1.45, 0.0, 0.0]), scene.state.q, scene.state.finger_position)
    return replace(scene, state=state, static_obstacles=(*OBSTACLES, *SHELF))


def random_shelf(count: int, seed: int) -> Scene:
    """`count` cylinders at random places in a shelf."""
    return shelf_scene(*random_scene(count, seed).objects)
