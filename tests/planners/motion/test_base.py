"""Base paths: no part of the robot hits anything; where there is no path, the reason is given."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from assets.robots import FETCH
from planners.clock import Deadline
from planners.collision.ground_map import GroundMap
from planners.collision.world import PADDING, STEP, CollisionWorld
from planners.motion.base import BaseRoadmap, plan_base
from planners.motion.lattice import ways_to
from planners.motion.path import CLEARANCE, NO_WAY, NoPath, WholeBodyPath
from planners.scene import SELF_BIT, HeldObject, StaticObstacle
from tests.planners.motion_scenes import mixed_scene
from tests.planners.scenes import ROOM, cylinder, table_scene, wall

HOME = np.array(FETCH.home)
HANGING = HeldObject("object_00", np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.02], [0, 0, 0, 1.0]]))
BEFORE_THE_TABLE = np.array([-0.9, 0.3, 0.4])


def world_with(*walls: StaticObstacle) -> CollisionWorld:
    """A table with one object, and walls."""
    scene = table_scene(cylinder("object_00", 0.0, 0.0))
    return CollisionWorld.from_scene(replace(scene, static_obstacles=(*scene.static_obstacles, *walls)))


def is_free(world: CollisionWorld, path: WholeBodyPath, held: HeldObject | None) -> bool:
    """Whether nothing is hit when it is checked finer."""
    return not world.with_padding(0.0).path_hits(path.configurations, path.opening, held, step=STEP / 4)


@pytest.mark.parametrize("held", [None, HANGING])
def test_drives_are_free_when_checked_finer_and_end_where_asked(held: HeldObject | None) -> None:
    world = CollisionWorld.from_scene(mixed_scene(20, 0))
    rng = np.random.default_rng(0)
    planned = 0
    for _ in range(30):
        start, goal = (
            np.array([rng.uniform(-1.4, -0.7), rng.uniform(-0.5, 0.5), rng.uniform(-0.6, 0.6)]) for _ in "ab"
        )
        if world.hits(start, HOME, FETCH.max_opening, held) or world.hits(goal, HOME, FETCH.max_opening, held):
            continue
        path = plan_base(world, start, goal, HOME, held=held)
        assert isinstance(path, WholeBodyPath)
        planned += 1
        assert np.allclose(path.configurations[0, :3], start)
        assert np.allclose(path.end_base, goal)
        tight = world.with_padding(0.0)
        for opening in (0.0, FETCH.max_opening):
            assert tight.path_hits(path.configurations, opening, held, step=STEP / 4) == 0
    assert planned >= 15


def test_the_shorter_turn_is_taken_and_yaw_is_continuous() -> None:
    world = CollisionWorld.from_scene(table_scene())
    path = plan_base(world, [-1.5, 0.0, 3.0], [-1.5, 0.2, -3.0], HOME)
    assert isinstance(path, WholeBodyPath)
    turned = np.diff(path.configurations[:, 2]).sum()
    assert turned == pytest.approx(2 * math.pi - 6.0)


def test_a_detour_is_found_where_the_straight_line_is_blocked() -> None:
    """An object as high as the gripper stands between start and goal."""
    tower = cylinder("object_00", -0.45, 0.0, radius=0.1, height=0.6)
    world = CollisionWorld.from_scene(table_scene(tower))
    start, goal = np.array([-1.05, 0.0, 0.0]), np.array([-1.05, -0.9, 0.0])  # the gripper is 0.45 m to the left
    straight = np.hstack([np.stack([start, goal]), np.tile(HOME, (2, 1))])
    assert world.path_hits(straight, FETCH.max_opening)
    path = plan_base(world, start, goal, HOME)
    assert isinstance(path, WholeBodyPath)
    assert world.path_hits(path.configurations, FETCH.max_opening) == 0


@pytest.mark.parametrize(
    ("start", "goal", "name"), [((0.0, 0, 0), (-1, 0, 0), "start"), ((-1, 0, 0), (0.2, 0, 0), "goal")]
)
def test_standing_inside_an_obstacle_is_named(start: tuple[float, ...], goal: tuple[float, ...], name: str) -> None:
    found = plan_base(CollisionWorld.from_scene(table_scene()), start, goal, HOME)
    assert isinstance(found, NoPath)
    assert name in found.reason
    assert "static obstacle" in found.reason


@pytest.mark.parametrize("held", [None, HANGING])
def test_the_base_drives_around_a_long_wall(held: HeldObject | None) -> None:
    world = world_with(wall("long", (-1.8, -2.2), (-1.8, 2.2)))
    path = plan_base(world, [-2.9, 0.0, 0.0], BEFORE_THE_TABLE, HOME, held=held)
    assert isinstance(path, WholeBodyPath)
    assert np.abs(path.configurations[:, 1]).max() > 2.2
    assert is_free(world, path, held)


@pytest.mark.parametrize("held", [None, HANGING])
@pytest.mark.parametrize("yaw", [0.0, 1.0, 2.0, 4.0])
def test_the_base_drives_through_a_door_of_90_cm(held: HeldObject | None, yaw: float) -> None:
    world = world_with(*ROOM)
    path = plan_base(world, [-3.4, 0.5, yaw], BEFORE_THE_TABLE, HOME, held=held)
    assert isinstance(path, WholeBodyPath)
    assert is_free(world, path, held)
    back = plan_base(world, BEFORE_THE_TABLE, [-3.4, 0.5, yaw], HOME, held=held)
    assert isinstance(back, WholeBodyPath)


def test_a_closed_room_is_refuted_by_the_ground_alone() -> None:
    world = world_with(*ROOM, wall("door", (-1.8, -0.5), (-1.8, 0.5)))
    roadmap = BaseRoadmap(GroundMap(world.scene))
    assert plan_base(world, [-3.4, 0.5, 1.0], BEFORE_THE_TABLE, HOME, roadmap=roadmap) is NO_WAY
    assert not roadmap.ground.are_connected([-3.4, 0.5], BEFORE_THE_TABLE)[0]
    assert not roadmap.excludes(np.array([-3.4, 0.5, 1.0]), BEFORE_THE_TABLE), "nothing had to be explored"


@pytest.mark.slow
def test_where_the_base_fits_and_the_robot_does_not_the_answer_holds_for_all_goals_behind() -> None:
    """A bar across the door, under which only the base fits."""
    bar = StaticObstacle("bar", np.array([-1.8, 0.0, 1.1]), np.array([0.05, 0.6, 0.1]))
    world, start = world_with(*ROOM, bar), np.array([-3.4, 0.5, 1.0])
    roadmap = BaseRoadmap(GroundMap(world.scene))
    assert roadmap.ground.are_connected(start, BEFORE_THE_TABLE)[0]
    assert plan_base(world, start, BEFORE_THE_TABLE, HOME, roadmap=roadmap) is NO_WAY
    assert roadmap.excludes(start, np.array([-1.0, -0.4, 0.0]))
    assert not roadmap.excludes(start, np.array([-3.0, -0.5, 2.0]))
    nothing_reached = BaseRoadmap(roadmap.ground, {(0, 0.0, start.tobytes(), 0.0, 0): (None, np.zeros((0, 3)))})
    assert nothing_reached.excludes(start, np.array([-1.0, -0.4, 0.0]))
    assert not nothing_reached.excludes(start + 0.1, np.array([-1.0, -0.4, 0.0]))


@dataclass(frozen=True)
class OverAfterLooks(Deadline):
    """A deadline that is over once it has been asked so often."""

    looks: int = 1
    asked: list[int] = field(default_factory=list)

    @property
    def is_over(self) -> bool:
        self.asked.append(1)
        return len(self.asked) > self.looks


@pytest.mark.parametrize("looks", [0, 1, 4])
def test_a_search_for_a_drive_ends_at_the_deadline_and_nothing_is_concluded_from_it(looks: int) -> None:
    bar = StaticObstacle("bar", np.array([-1.8, 0.0, 1.1]), np.array([0.05, 0.6, 0.1]))
    world, start = world_with(*ROOM, bar), np.array([-3.4, 0.5, 1.0])
    roadmap, deadline = BaseRoadmap(GroundMap(world.scene)), OverAfterLooks(looks=looks)
    late = plan_base(world, start, BEFORE_THE_TABLE, HOME, roadmap=roadmap, deadline=deadline)
    assert isinstance(late, NoPath)
    assert "the time was up" in late.reason
    assert len(deadline.asked) <= looks + 3, "the search goes on"
    assert not roadmap.excludes(start, BEFORE_THE_TABLE)
    assert plan_base(world, start, BEFORE_THE_TABLE, HOME, roadmap=roadmap) is NO_WAY
    assert roadmap.excludes(start, BEFORE_THE_TABLE)


@pytest.mark.parametrize("seed", range(3))
def test_ways_along_the_ground_are_shortest_ones(seed: int) -> None:
    """Against Dijkstra's algorithm on the graph of neighbouring cells."""
    rng = np.random.default_rng(seed)
    parts, cell = (rng.random((23, 31)) > 0.35).astype(np.int64), 0.05
    parts[4, 7] = 1
    edges = [
        (i * 31 + j, a * 31 + b, cell * math.hypot(a - i, b - j))
        for i, j in np.argwhere(parts)
        for a in range(i - 1, i + 2)
        for b in range(j - 1, j + 2)
        if (a, b) != (i, j) and 0 <= a < 23 and 0 <= b < 31 and parts[a, b]
    ]
    rows, columns, lengths = zip(*edges, strict=True)
    graph = csr_array((lengths, (rows, columns)), shape=(23 * 31, 23 * 31))
    expected = dijkstra(graph, indices=4 * 31 + 7).reshape(23, 31)
    found = ways_to(np.array([0.22, 0.38, 0.0]), parts, np.zeros(2), cell)
    assert np.array_equal(np.isinf(found), np.isinf(expected))
    assert np.allclose(found[np.isfinite(found)], expected[np.isfinite(expected)])


def test_a_drive_keeps_a_centimetre_from_all_else_where_what_is_held_is_nearer_to_the_robot() -> None:
    start, goal = np.array([-1.0, 0.05, 0.0]), np.array([-1.0, -0.95, 0.0])  # the gripper is 0.45 m to the left
    # An object that is held farther and farther back comes near to the robot at home.
    for back in np.arange(0.1, 0.3, 0.002):
        held = replace(HANGING, T_tcp_object=np.array([[1, 0, 0, -back], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]))
        near, nearer = (world_with().with_padding(gap).hits(start, HOME, 0.0, held) for gap in (CLEARANCE, PADDING))
        if near >> SELF_BIT & 1:
            break
    assert near >> SELF_BIT & 1
    assert not nearer
    # A wall before it: the straight drive passes that at half a centimetre, one farther back at more.
    X = np.stack([np.concatenate((base, HOME)) for base in (start, goal)])
    worlds = (world_with(wall("before", (x, -0.02), (x, 0.02))) for x in np.arange(0.0, -1.0, -0.002))
    world = next(one for one in worlds if one.with_padding(0.7 * CLEARANCE).path_hits(X, 0.0, held, 1 << SELF_BIT))
    passes = [world.with_padding(gap).path_hits(X, 0.0, held, 1 << SELF_BIT) for gap in (CLEARANCE, PADDING)]
    assert passes[0]
    assert not passes[1]
    path = plan_base(world, start, goal, HOME, held=held)
    assert isinstance(path, WholeBodyPath)
    assert not world.with_padding(0.99 * CLEARANCE).path_hits(path.configurations, 0.0, held, 1 << SELF_BIT)
