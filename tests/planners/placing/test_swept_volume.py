"""What taking an object sweeps, against sample points on robot and object; the region that is drawn is the one used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from assets.robots import FETCH
from irm.chain import BASE
from planners.collision.hit_kernels import place_along
from planners.collision.world import CollisionWorld
from planners.drawing.choices import choices_of
from planners.grasping.candidates import GraspCandidate
from planners.motion.approaches import APPROACH_PATTERNS, ContactQuery, planned_approach, trace
from planners.motion.arm import tcp_pose
from planners.motion.path import on_base
from planners.placing import surfaces
from planners.placing.negative_goal_region import NegativeGoalRegion, SupportGrid, SweptVolume, is_free, swept_mask
from planners.placing.swept_volume import grasp_volume, path_volume, standing_volume
from planners.planner import Planner
from planners.scene import HeldObject, Scene, StaticObstacle
from planners.tamp.solution import Solution
from planners.workspace import Workspace
from tests.planners.scenes import HEIGHT, cylinder, random_scene, table_scene

TALL = 0.2
BOARD = StaticObstacle("board", np.array([0.0, 0.0, HEIGHT + 0.41]), np.array([0.35, 0.5, 0.01]))


def grasps(scene: Scene, name: str) -> list[GraspCandidate]:
    """Grasps of an object along which it can be taken."""
    world = CollisionWorld.from_scene(scene)
    found = Workspace.of(scene.robot, scene, grasps="side").grasps().for_object(scene, name)
    return [grasp for grasp in found if planned_approach(world, grasp.base, grasp.q, name) is not None]


def volume_of(world: CollisionWorld, grasp: GraspCandidate) -> SweptVolume:
    """What taking an object through a grasp sweeps, along the approach planned for it."""
    return grasp_volume(world, grasp, planned_approach(world, grasp.base, grasp.q, grasp.object))


def points_of_robot(world: CollisionWorld, x: np.ndarray, opening: float, rng: np.random.Generator) -> np.ndarray:
    """Points (n, 3) inside the arm and the torso, from the poses of single solids."""
    robot, (position, rotation), points = world.robot, place_along(world.query(opening), x[None]), []
    for i in np.flatnonzero(robot.link != BASE):
        inside = rng.uniform(-1, 1, (60, 3)) * robot.half[i]
        around = rng.normal(size=(60, 3))
        inside += robot.radius[i] * around / np.linalg.norm(around, axis=1, keepdims=True)
        points.append(position[0, i] + inside @ rotation[0, i].T)
    return np.concatenate(points)


def points_of_object(world: CollisionWorld, x: np.ndarray, held: HeldObject, rng: np.random.Generator) -> np.ndarray:
    """Points (n, 3) on the surface of the held cylinder."""
    half, angle = world.scene.body(held.name).half_extents, rng.uniform(0, 2 * np.pi, 200)
    local = np.column_stack((half[0] * np.cos(angle), half[0] * np.sin(angle), rng.uniform(-half[2], half[2], 200)))
    chain_pose = world.scene.with_state(replace(world.scene.state, base=x[:3], q=x[3:])).state
    T = tcp_pose(FETCH, chain_pose) @ held.T_tcp_object
    return local @ T[:3, :3].T + T[:3, 3]


def missed(grid: SupportGrid, mask: np.ndarray, points: np.ndarray) -> int:
    """Points above the plane and below `TALL` whose cells are not set."""
    low = points[(points[:, 2] > grid.height) & (points[:, 2] < grid.height + TALL)]
    index = np.floor((low[:, :2] - (grid.x0, grid.y0)) / grid.resolution).astype(int)
    index = index[((index >= 0) & (index < grid.shape)).all(axis=1)]
    return int((~mask[index[:, 0], index[:, 1]]).sum())


@pytest.mark.parametrize("covered", [False, True])
def test_the_volume_of_a_grasp_covers_robot_and_object_on_the_whole_way(covered: bool) -> None:
    scene, rng = random_scene(8, 4), np.random.default_rng(0)
    if covered:
        scene = replace(scene, static_obstacles=(*scene.static_obstacles, BOARD))
    world, grid, tried = CollisionWorld.from_scene(scene), SupportGrid.over(scene.support), 0
    for name in scene.names[:4]:
        for grasp in grasps(scene, name)[:: 40 if not covered else 1][:2]:
            planned = planned_approach(world, grasp.base, grasp.q, name)
            assert planned is not None
            query, approach = planned
            mask = swept_mask(grid, volume_of(world, grasp), TALL)
            for x in approach.empty[::4]:
                assert missed(grid, mask, points_of_robot(world, x, query.empty.opening, rng)) == 0
            for x in approach.loaded[::4]:
                assert missed(grid, mask, points_of_robot(world, x, query.loaded.opening, rng)) == 0
                assert missed(grid, mask, points_of_object(world, x, query.held, rng)) == 0
            standing = swept_mask(grid, standing_volume(world, grasp), TALL)
            assert not (standing & ~mask).any()
            tried += 1
    assert tried > 1


def test_the_way_of_an_object_that_is_drawn_out_is_kept_clear() -> None:
    scene = table_scene(cylinder("object_00", 0.2, -0.2))
    world, grid, tried = CollisionWorld.from_scene(scene), SupportGrid.over(scene.support), 0
    for grasp in grasps(scene, "object_00"):
        query = ContactQuery.grasp(world, grasp.base, grasp.q, "object_00")
        approach = trace(query, APPROACH_PATTERNS[-1])
        if isinstance(approach, str):
            continue
        swept = swept_mask(grid, grasp_volume(world, grasp, (query, approach)), TALL)
        standing = swept_mask(grid, standing_volume(world, grasp), TALL)
        away = np.array([np.cos(grasp.yaw), np.sin(grasp.yaw)])
        on_the_way = scene.objects[0].position[:2] - np.linspace(0.0, 0.14, 8)[:, None] * away
        sideways = on_the_way[:, None] + np.array([[-1.0], [1.0]]) * 0.025 * np.array([-away[1], away[0]])
        cells = np.floor((sideways.reshape(-1, 2) - (grid.x0, grid.y0)) / grid.resolution).astype(int)
        assert swept[cells[:, 0], cells[:, 1]].all()
        assert (swept & ~standing).any()
        tried += 1
    assert tried > 3


def test_where_the_torso_lifts_the_arm_nothing_is_swept_besides_what_the_grasp_and_the_object_occupy() -> None:
    scene = random_scene(12, 5)
    world, grid, tried = CollisionWorld.from_scene(scene), SupportGrid.over(scene.support), 0
    for name in scene.names:
        for grasp in grasps(scene, name)[::2]:
            planned = planned_approach(world, grasp.base, grasp.q, name)
            assert planned is not None
            query, approach = planned
            if approach.pattern.by_torso:
                ends = on_base(grasp.base, grasp.q[None])
                parts = (standing_volume(world, grasp), path_volume(world, ends, query.loaded.opening, query.held))
                alone = np.any([swept_mask(grid, part, TALL) for part in parts], axis=0)
                np.testing.assert_array_equal(swept_mask(grid, volume_of(world, grasp), TALL), alone)
                tried += 1
    assert tried > 3


@pytest.mark.slow
@pytest.mark.parametrize("supports", [None, "all"])
def test_the_region_drawn_is_the_region_used(monkeypatch: pytest.MonkeyPatch, supports: str | None) -> None:
    """Every region drawn was made by the planner, and the locations that it tried were compared with that region."""
    made: list[NegativeGoalRegion] = []
    compared: list[np.ndarray] = []
    make, compare = surfaces.negative_goal_region, surfaces.is_free

    def making(*args: object) -> NegativeGoalRegion:
        made.append(make(*args))  # type: ignore[arg-type] # as the planner calls it
        return made[-1]

    def comparing(grid: SupportGrid, mask: np.ndarray, locations: np.ndarray, radius: float) -> np.ndarray:
        compared.append(mask)
        return compare(grid, mask, locations, radius)

    monkeypatch.setattr(surfaces, "negative_goal_region", making)
    monkeypatch.setattr(surfaces, "is_free", comparing)
    scene = replace(random_scene(25, 3), supports=("table_top", "counter_left", "counter_right"))
    planner = Planner(FETCH, grasps="side", supports=supports)
    target = next(name for name in scene.names if (planner.clearance_floor(scene, name).count or 0) > 1)
    plan = planner.solve(scene, target)
    assert isinstance(plan, Solution)
    used = list(compared)
    puts = [action for action in plan.actions if action.is_put_down]
    for put, choice in zip(puts, choices_of(plan), strict=True):
        assert len(choice.surfaces) == (1 if supports is None else 3)
        assert choice.surfaces[0].region.ngr1.any()
        free = []
        for drawn, surface in zip(choice.surfaces, put.surfaces, strict=True):
            assert any(drawn.region is region for region in made)
            assert any(np.array_equal(surface.blocked, mask) for mask in used)
            assert not (drawn.region.mask & ~surface.blocked).any()
            assert put.released is not None
            location = put.released.position[None, :2]
            free.append(bool(is_free(drawn.grid, drawn.region.mask, location, put.released.radius)[0]))
        assert any(free)
