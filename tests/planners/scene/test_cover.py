"""Laws of the way out from under a board."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planners.scene.cover import BACK, DRIVE_CLEARANCE, direction_out, drive_out, heading, is_covered, objects_before
from planners.scene.solid import StaticObstacle
from tests.planners.scenes import DEPTH, HEIGHT, cylinder, shelf_scene, table_scene


def gripper(x: float, y: float, yaw: float, pitch: float = 0.0) -> np.ndarray:
    """T_world_tcp (4, 4) of a gripper above the table."""
    c, s, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    T = np.eye(4)
    T[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    T[:3, 3] = x, y, HEIGHT + 0.08
    return T


def test_only_what_stands_under_the_board_is_covered() -> None:
    assert is_covered(shelf_scene(), (0.0, 0.0, HEIGHT))
    assert not is_covered(shelf_scene(), (0.0, 0.9, HEIGHT))
    assert not is_covered(table_scene(), (0.0, 0.0, HEIGHT))


def test_the_wall_of_a_bin_is_no_shelf() -> None:
    """It begins above the bin's floor, 1 cm above the table: nothing stands under it."""
    scene = table_scene()
    wall = StaticObstacle("wall of a bin", np.array([0.05, 0.0, HEIGHT + 0.06]), np.array([0.005, 0.05, 0.05]))
    scene = replace(scene, static_obstacles=(*scene.static_obstacles, wall))
    assert not is_covered(scene, (0.0, 0.0, HEIGHT))


def test_a_piece_of_the_rim_of_a_bowl_is_no_shelf() -> None:
    scene = table_scene()
    rim = StaticObstacle("bowl/rim", np.array([0.1, 0.0, HEIGHT + 0.04]), np.array([0.01, 0.02, 0.01]))
    scene = replace(scene, static_obstacles=(*scene.static_obstacles, rim))
    assert not is_covered(scene, (0.0, 0.0, HEIGHT))


@pytest.mark.parametrize(
    ("base", "direction"), [((-1.0, 0.3), (-1, 0)), ((0.1, 1.2), (0, 1)), ((0.9, 0.0), (1, 0)), ((0.0, -2.0), (0, -1))]
)
def test_the_direction_out_leads_across_the_side_before_which_the_base_stands(
    base: tuple[float, float], direction: tuple[float, float]
) -> None:
    assert np.allclose(direction_out(table_scene().support, (*base, 0.3)), direction)


@pytest.mark.parametrize("pitch", [0.0, 0.7, np.pi / 2])
def test_the_heading_of_a_gripper_is_its_yaw_at_any_pitch(pitch: float) -> None:
    assert np.allclose(heading(gripper(0.0, 0.0, 0.6, pitch)), (np.cos(0.6), np.sin(0.6)))


def test_a_drive_out_backs_off_and_ends_beyond_the_edge() -> None:
    support, base, T = table_scene().support, np.array([-0.8, 0.1, 0.2]), gripper(0.1, -0.2, 0.5)
    inside, backed_off, outside = drive_out(support, base, T)
    assert np.allclose(inside, base)
    assert np.allclose(backed_off[:2] - inside[:2], -BACK * heading(T))
    assert np.allclose(outside[1:], backed_off[1:])
    tcp = T[0, 3] + outside[0] - inside[0]
    assert tcp == pytest.approx(-DEPTH / 2 - DRIVE_CLEARANCE)


def test_objects_before_another_are_those_that_it_meets_on_the_direction_out() -> None:
    moved = cylinder("object_00", 0.1, 0.0)
    others = (
        cylinder("object_01", -0.1, 0.05),  # partly before it
        cylinder("object_02", -0.1, 0.10),  # beside its way
        cylinder("object_03", 0.25, 0.0),  # behind it
    )
    scene = shelf_scene(moved, *others)
    assert scene.names_of(objects_before(scene, moved, np.zeros((1, 2)), np.array([-1.0, 0.0]))[0]) == ("object_01",)
    assert scene.names_of(objects_before(scene, moved, np.zeros((1, 2)), np.array([1.0, 0.0]))[0]) == ("object_03",)
