"""Laws of generated grasps and placement locations."""

from __future__ import annotations

import math

import numpy as np
import pytest

from assets.robots import FETCH
from planners.grasping.grasp_poses import (
    GraspConfig,
    GraspPose,
    UnknownGraspKindError,
    generate_grasps,
    grasp_after_move,
    gripper_opening,
)
from planners.placing.locations import PlacementConfig, placement_grid, placement_levels, stand_at
from planners.scene import Body, StaticObstacle

TABLE = StaticObstacle("table_top", np.array([0.0, 0.0, 0.73]), np.array([0.35, 0.5, 0.02]))
BOTH = GraspConfig(kinds=("side", "top"))
LYING = (math.cos(math.pi / 4), math.sin(math.pi / 4), 0.0, 0.0)


def quaternion(yaw: float) -> np.ndarray:
    return np.array([math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)])


def cylinder(radius: float = 0.03, height: float = 0.16) -> Body:
    position = np.array([0.1, -0.2, TABLE.top + height / 2])
    return Body("object_00", "cylinder", np.array([radius, radius, height / 2]), position, quaternion(0.0))


def box(half_x: float, half_y: float, yaw: float = 0.0) -> Body:
    position = np.array([0.1, -0.2, TABLE.top + 0.07])
    return Body("object_01", "box", np.array([half_x, half_y, 0.07]), position, quaternion(yaw))


def toppled() -> Body:
    return cylinder().at((0.1, -0.2, TABLE.top + 0.03), LYING)


def span(grasp: GraspPose, body: Body) -> float:
    """Width of the body along the finger motion."""
    return 2 * body.half_extent_along(grasp.T_world_tcp[:3, 1])


@pytest.mark.parametrize("body", [cylinder(), cylinder(height=0.06), box(0.02, 0.035, 0.4), toppled()])
def test_every_grasp_is_a_rigid_pose_that_holds_the_object_between_the_fingers(body: Body) -> None:
    grasps = generate_grasps(body, FETCH, BOTH)
    assert {grasp.kind for grasp in grasps} == {"side", "top"}
    for grasp in grasps:
        rotation = grasp.T_world_tcp[:3, :3]
        np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        assert span(grasp, body) < grasp.opening <= FETCH.max_opening
        assert body.bottom < grasp.T_world_tcp[2, 3] < body.top
        assert not grasp.T_world_tcp.flags.writeable
        expected = (math.cos(grasp.yaw), math.sin(grasp.yaw), 0.0)
        np.testing.assert_allclose(rotation[:, 0 if grasp.kind == "side" else 2], expected, atol=1e-12)


def test_side_grasps_of_a_cylinder_are_n_turns_about_its_axis_at_delta() -> None:
    body = cylinder()
    grasps = generate_grasps(body, FETCH)
    assert len(grasps) == 6
    yaws = sorted(grasp.yaw for grasp in grasps)
    np.testing.assert_allclose(np.diff(yaws), math.pi / 3)
    for grasp in grasps:
        np.testing.assert_allclose(grasp.T_world_tcp[:2, 3], body.position[:2])
        assert grasp.T_world_tcp[2, 3] - body.bottom == pytest.approx(FETCH.grasp_height)
        assert grasp.T_world_tcp[2, 2] == 1.0
        assert grasp.opening == pytest.approx(gripper_opening(FETCH, 0.03))


def test_a_box_is_grasped_across_faces_the_fingers_can_span() -> None:
    yaw = 0.4
    assert len(generate_grasps(box(0.02, 0.03, yaw), FETCH)) == 4
    wide = generate_grasps(box(0.02, 0.08, yaw), FETCH)
    assert len(wide) == 2
    for grasp in wide:
        assert abs(math.sin(grasp.yaw - yaw)) == pytest.approx(1.0)
    assert generate_grasps(box(0.08, 0.08), FETCH) == ()


def test_a_toppled_cylinder_is_taken_by_its_ends_without_the_palm_touching_it() -> None:
    body, config = toppled(), GraspConfig()
    grasps = generate_grasps(body, FETCH, config)
    assert len(grasps) == 2
    for grasp in grasps:
        approach = grasp.T_world_tcp[:3, 0]
        behind = (grasp.T_world_tcp[:3, 3] - body.position) @ approach + body.half_extent_along(approach)
        assert behind <= config.palm_reach + 1e-12
        assert grasp.T_world_tcp[2, 3] >= body.bottom + config.palm_height


def test_grasp_goes_with_the_object() -> None:
    body = box(0.02, 0.03, 0.4)
    moved = stand_at(body, np.array([-0.1, 0.3, TABLE.top]), turn=1.0)
    assert moved.bottom == pytest.approx(TABLE.top)
    np.testing.assert_allclose(moved.position[:2], (-0.1, 0.3))
    for grasp in generate_grasps(body, FETCH, BOTH):
        after = grasp_after_move(grasp, body.pose, moved.pose)
        T_before = np.linalg.inv(body.pose) @ grasp.T_world_tcp
        np.testing.assert_allclose(np.linalg.inv(moved.pose) @ after.T_world_tcp, T_before, atol=1e-12)
        assert math.cos(after.yaw - grasp.yaw - 1.0) == pytest.approx(1.0)


def test_unknown_kinds_are_misuse() -> None:
    with pytest.raises(UnknownGraspKindError, match="side, top"):
        generate_grasps(cylinder(), FETCH, GraspConfig(kinds=("back",)))  # type: ignore[arg-type]  # misuse


def test_placement_grid_has_the_papers_25_points_within_the_margin() -> None:
    grid = placement_grid(TABLE, PlacementConfig(margin=0.06))
    assert grid.shape == (25, 2)
    np.testing.assert_allclose(grid.max(axis=0), (0.29, 0.44))
    np.testing.assert_allclose(grid.min(axis=0), (-0.29, -0.44))


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
