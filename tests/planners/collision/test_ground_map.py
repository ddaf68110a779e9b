"""What the map of the ground proves: places in different parts are apart for the base, free ones are in some part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from assets.robots import robot
from planners.collision.ground_map import GroundMap
from planners.collision.world import CollisionWorld
from planners.motion.base import plan_base
from planners.motion.path import WholeBodyPath
from planners.scene import Scene, StaticObstacle
from tests.planners.scenes import ROOM, table_scene, wall

SHUT = (*ROOM, wall("door", (-1.8, -0.5), (-1.8, 0.5)))


def random_ground(seed: int, name: str = "fetch") -> Scene:
    """A table and boxes, cylinders and walls that are in the way of the base, some turned."""
    rng, spec = np.random.default_rng(seed), robot(name)
    obstacles = []
    for k in range(25):
        c, s = np.cos(angle := rng.uniform(0, np.pi)), np.sin(angle)
        half = np.append(rng.uniform(0.02, 0.8, 2), 0.5)
        shape = "cylinder" if k % 3 == 0 else "box"
        half[1] = half[0] if shape == "cylinder" else half[1]
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        obstacles.append(StaticObstacle(f"one_{k}", np.append(rng.uniform(-4, 4, 2), 0.5), half, shape, R))
    scene = table_scene()
    state = replace(scene.state, q=np.array(spec.home))
    return replace(scene, robot=spec, state=state, static_obstacles=(*scene.static_obstacles, *obstacles))


def test_the_map_reaches_around_what_the_base_passes_below() -> None:
    """Two table tops without legs, the second one far from where the robot starts; a pillar bars the simple drives."""
    scene = table_scene()
    tops = [StaticObstacle(f"top_{k}", np.array([0.0, 3.0 * k, 0.7]), np.array([0.3, 0.3, 0.02])) for k in range(2)]
    pillar = StaticObstacle("pillar", np.array([-1.1, 0.8, 1.0]), np.array([0.4, 0.1, 1.0]))
    world = CollisionWorld.from_scene(replace(scene, static_obstacles=(*tops, pillar)))
    drive = plan_base(world, scene.state.base, [-1.0, 3.7, -0.6], scene.state.q)
    assert isinstance(drive, WholeBodyPath), drive


@pytest.mark.parametrize("name", ["fetch", "pr2", "panda_mobile"])
def test_wherever_the_robot_is_free_the_map_has_a_part(name: str) -> None:
    scene = random_ground(3, name)
    world, ground, rng = CollisionWorld.from_scene(scene), GroundMap(scene), np.random.default_rng(0)
    bases = np.column_stack([rng.uniform(-5, 5, (4000, 2)), rng.uniform(-3, 3, 4000)])
    home = np.array(scene.robot.home)
    free = np.array([not world.hits(base, home, 0.0) for base in bases])
    assert 200 < free.sum() < 3800
    assert (ground.part_of(bases[free]) > 0).all()
    assert (ground.part_of(bases) == 0).sum() > 200


def test_places_between_which_a_drive_is_found_are_connected() -> None:
    scene = random_ground(5)
    world, ground, rng = CollisionWorld.from_scene(scene), GroundMap(scene), np.random.default_rng(1)
    home, found = np.array(scene.robot.home), 0
    while found < 6:
        start, goal = np.column_stack([rng.uniform(-5, 5, (2, 2)), rng.uniform(-3, 3, 2)])
        path = plan_base(world, start, goal, home)
        if isinstance(path, WholeBodyPath):
            found += 1
            assert ground.are_connected(start, goal)[0]


def test_a_room_without_a_door_is_a_part_of_its_own() -> None:
    scene = table_scene()
    places = np.array([[-3.4, 0.5], [-1.0, 0.0], [-20.0, 0.0], [-3.4, -1.5]])
    shut = GroundMap(replace(scene, static_obstacles=(*scene.static_obstacles, *SHUT)))
    assert shut.are_connected(places[0], places).tolist() == [True, False, False, True]
    assert shut.are_connected(places[1], places).tolist() == [False, True, True, False]
    ajar = GroundMap(replace(scene, static_obstacles=(*scene.static_obstacles, *ROOM)))
    assert ajar.are_connected(places[0], places).all()


def test_nothing_is_proved_by_a_start_inside_an_obstacle() -> None:
    scene = table_scene()
    shut = GroundMap(replace(scene, static_obstacles=(*scene.static_obstacles, *SHUT)))
    assert shut.are_connected([-1.8, 1.0], [[-3.4, 0.5], [-1.0, 0.0]]).all()
