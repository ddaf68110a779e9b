"""Laws of generated grasps and placement locations."""

from __future__ import annotations

import math

import numpy as np
import pytest

from assets.robots import FETCH
from planners.collision.world import CollisionWorld
from planners.grasping.arm_configurations import gripper_hits
from planners.grasping.candidates import gripper_poses
from planners.grasping.families import GRASP_SETS, SIDE, TOP, GraspFamily, UnknownGraspSet, find_grasp_set
from planners.grasping.grasp_poses import (
    GraspPose,
    GripperClearances,
    generate_grasps,
    gripper_clearances,
    gripper_opening,
)
from planners.placing.locations import placement_grid, placement_levels, stand_at
from planners.scene import Body, StaticObstacle
from tests.planners.scenes import HEIGHT, table_scene

TABLE = StaticObstacle("table_top", np.array([0.0, 0.0, HEIGHT - 0.02]), np.array([0.35, 0.5, 0.02]))
LYING = (math.cos(math.pi / 4), math.sin(math.pi / 4), 0.0, 0.0)
FAMILIES = tuple(family for family in GRASP_SETS["all"] if isinstance(family, GraspFamily))
SLANTED = tuple(family for family in FAMILIES if family.depth is not None)


def quaternion(yaw: float) -> np.ndarray:
    return np.array([math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)])


def cylinder(radius: float = 0.03, height: float = 0.16) -> Body:
    position = np.array([0.1, -0.2, TABLE.top + height / 2])
    return Body("object_00", "cylinder", np.array([radius, radius, height / 2]), position, quaternion(0.0))


def box(half_x: float, half_y: float, yaw: float = 0.0, height: float = 0.14) -> Body:
    position = np.array([0.1, -0.2, TABLE.top + height / 2])
    return Body("object_00", "box", np.array([half_x, half_y, height / 2]), position, quaternion(yaw))


def toppled(radius: float = 0.03, height: float = 0.16) -> Body:
    return cylinder(radius, height).at((0.1, -0.2, TABLE.top + radius), LYING)


THINGS = {
    "cylinder": cylinder(),
    "wide cylinder": cylinder(0.035, 0.20),
    "low cylinder": cylinder(height=0.06),
    "box": box(0.02, 0.035, 0.4),
    "toppled cylinder": toppled(),
    "thin toppled cylinder": toppled(0.025),
    "lying box": box(0.07, 0.024, 0.4, height=0.05),
    "toppled box": box(0.024, 0.028).at((0.1, -0.2, TABLE.top + 0.028), LYING),
}


def span(grasp: GraspPose, body: Body) -> float:
    """Width of the body along the finger motion."""
    return 2 * body.half_extent_along(grasp.T_world_tcp[:3, 1])


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.name)
@pytest.mark.parametrize("body", THINGS.values(), ids=THINGS)
def test_every_grasp_is_a_rigid_pose_that_holds_the_object_between_the_fingers(body: Body, family: GraspFamily) -> None:
    grasps = generate_grasps(body, FETCH, (family,))
    assert grasps
    for grasp in grasps:
        rotation = grasp.T_world_tcp[:3, :3]
        np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        assert span(grasp, body) < grasp.opening <= FETCH.max_opening
        assert body.bottom < grasp.T_world_tcp[2, 3] < body.top
        assert not grasp.T_world_tcp.flags.writeable
        cy, sy, down, level = math.cos(grasp.yaw), math.sin(grasp.yaw), math.sin(family.pitch), math.cos(family.pitch)
        np.testing.assert_allclose(rotation[:, 0], (cy * level, sy * level, -down), atol=1e-12)
        np.testing.assert_allclose(rotation[:, 1], (-sy, cy, 0.0), atol=1e-12)


@pytest.mark.parametrize("family", SLANTED, ids=lambda family: family.name)
@pytest.mark.parametrize(
    "body",
    [cylinder(radius, height) for radius in (0.025, 0.035) for height in (0.04, 0.05, 0.06, 0.12, 0.2)]
    + [THINGS[name] for name in ("toppled cylinder", "thin toppled cylinder", "lying box", "toppled box", "box")],
)
def test_the_open_gripper_touches_neither_the_object_nor_the_table(body: Body, family: GraspFamily) -> None:
    """The exact collision check agrees with the lengths that the poses are computed from."""
    world = CollisionWorld.from_scene(table_scene(body))
    grasps = generate_grasps(body, FETCH, (family,))
    assert grasps
    for grasp in grasps:
        assert not gripper_hits(world, gripper_poses([grasp]), grasp.opening)[0]


def test_side_grasps_of_a_cylinder_are_n_turns_about_its_axis_at_delta() -> None:
    body = cylinder()
    grasps = generate_grasps(body, FETCH)
    assert len(grasps) == SIDE.directions == 24
    yaws = sorted(grasp.yaw for grasp in grasps)
    np.testing.assert_allclose(np.diff(yaws), 2 * math.pi / 24)
    for grasp in grasps:
        np.testing.assert_allclose(grasp.T_world_tcp[:2, 3], body.position[:2])
        assert grasp.T_world_tcp[2, 3] - body.bottom == pytest.approx(FETCH.grasp_height)
        assert grasp.T_world_tcp[2, 2] == 1.0
        assert grasp.opening == pytest.approx(gripper_opening(FETCH, 0.03))


def test_top_grasps_are_half_a_turn_apart_at_most() -> None:
    yaws = np.array([grasp.yaw for grasp in generate_grasps(cylinder(), FETCH, (TOP,))])
    assert len(yaws) == TOP.directions // 2
    assert len(np.unique(np.round(np.mod(yaws, math.pi), 9))) == len(yaws)


def test_a_box_is_grasped_across_faces_the_fingers_can_span() -> None:
    yaw = 0.4
    for family in FAMILIES:
        assert len(generate_grasps(box(0.02, 0.03, yaw), FETCH, (family,))) == (2 if family is TOP else 4)
        wide = generate_grasps(box(0.02, 0.08, yaw), FETCH, (family,))
        assert len(wide) == (1 if family is TOP else 2)
        for grasp in wide:
            assert abs(math.sin(grasp.yaw - yaw)) == pytest.approx(1.0)
        assert generate_grasps(box(0.08, 0.08), FETCH, (family,)) == ()


def test_a_toppled_cylinder_is_taken_by_its_ends_without_the_palm_touching_it() -> None:
    body, gripper = toppled(), gripper_clearances(FETCH)
    grasps = generate_grasps(body, FETCH)
    assert len(grasps) == 2
    for grasp in grasps:
        approach = grasp.T_world_tcp[:3, 0]
        behind = (grasp.T_world_tcp[:3, 3] - body.position) @ approach + body.half_extent_along(approach)
        assert behind <= gripper.palm_reach + 1e-12
        assert grasp.T_world_tcp[2, 3] >= body.bottom + gripper.palm_height


def test_an_object_put_elsewhere_stands_there_turned() -> None:
    body = box(0.02, 0.03, 0.4)
    moved = stand_at(body, np.array([-0.1, 0.3, TABLE.top]), turn=1.0)
    assert moved.bottom == pytest.approx(TABLE.top)
    np.testing.assert_allclose(moved.position[:2], (-0.1, 0.3))
    assert moved.yaw == pytest.approx(1.4)


def test_unknown_grasp_sets_are_misuse() -> None:
    with pytest.raises(UnknownGraspSet, match="side, tilted, top, all"):
        find_grasp_set("back")


def test_placement_grid_has_the_papers_25_points_within_the_margin() -> None:
    grid = placement_grid(TABLE)
    assert grid.shape == (25, 2)
    np.testing.assert_allclose(grid.max(axis=0), (0.305, 0.455))
    np.testing.assert_allclose(grid.min(axis=0), (-0.305, -0.455))


def test_levels_get_finer_stay_within_the_margin_and_depend_on_the_seed_alone() -> None:
    levels = list(placement_levels(TABLE, np.random.default_rng(0)))
    again = list(placement_levels(TABLE, np.random.default_rng(0)))
    assert [len(level) for level in levels] == [25, 81, 289, 1089]
    np.testing.assert_array_equal(levels[0], placement_grid(TABLE))
    for level, twin in zip(levels, again, strict=True):
        np.testing.assert_array_equal(level, twin)
        assert (np.abs(level) <= (0.305 + 1e-12, 0.455 + 1e-12)).all()


def test_a_table_smaller_than_its_margins_offers_its_centre() -> None:
    tiny = StaticObstacle("table_top", np.array([0.0, 0.0, 0.73]), np.array([0.04, 0.04, 0.02]))
    np.testing.assert_allclose(placement_grid(tiny), 0.0)


def test_the_lengths_of_the_gripper_are_read_from_its_solids():
    wanted = GripperClearances(
        palm_reach=0.044, palm_height=0.042, fingertip_reach=0.028, pad_half_height=0.0135, least_depth=0.018
    )
    assert gripper_clearances(FETCH) == wanted


def test_a_gripper_that_does_not_turn_grasps_only_from_its_own_yaws() -> None:
    """As one that always points down: a box has grasps across both pairs of faces, of which one pair is left."""
    box = Body("a", "box", np.array([0.02, 0.03, 0.02]), np.array([1.0, 0.0, 0.02]), np.array([1.0, 0.0, 0.0, 0.0]))
    every, some = (
        generate_grasps(box, FETCH, (GraspFamily("down", np.pi / 2, depth=0.02, yaws=yaws),))
        for yaws in (None, (-0.5, 0.5))
    )
    assert {round(grasp.yaw, 6) for grasp in every} == {0.0, round(np.pi / 2, 6)}
    assert [grasp.yaw for grasp in some] == [0.0]
