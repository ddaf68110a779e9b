"""Regions on the table against slow sampling twins, and laws of the order of clearance locations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planners.placing.locations import placement_grid
from planners.placing.negative_goal_region import (
    SupportGrid,
    SweptVolume,
    clearance_order,
    dilated,
    footprint_mask,
    is_free,
    join_volumes,
    negative_goal_region,
    swept_mask,
)
from planners.regions import Region
from planners.scene import Body, StaticObstacle

TABLE = StaticObstacle("table_top", np.array([0.0, 0.0, 0.73]), np.array([0.35, 0.5, 0.02]))
GRID = SupportGrid.over(TABLE)
COARSE = SupportGrid(-0.2, -0.2, 0.02, (20, 20), 0.75)
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def cylinder(x: float, y: float, radius: float = 0.03, name: str = "object_00") -> Body:
    return Body(name, "cylinder", np.array([radius, radius, 0.08]), np.array([x, y, 0.83]), UPRIGHT)


def random_spheres(rng: np.random.Generator, count: int) -> np.ndarray:
    centres = rng.uniform((-0.25, -0.25, 0.6), (0.25, 0.25, 1.1), (count, 3))
    return np.column_stack((centres, rng.uniform(0.02, 0.1, count)))


def random_boxes(rng: np.random.Generator, count: int) -> SweptVolume:
    return SweptVolume(
        box_centres=rng.uniform((-0.2, -0.2, 0.7), (0.2, 0.2, 1.0), (count, 3)),
        box_axes=Rotation.random(count, random_state=rng).as_matrix(),
        box_half_extents=rng.uniform(0.01, 0.08, (count, 3)),
    )


def cells_of_points(grid: SupportGrid, points: np.ndarray, height: float) -> np.ndarray:
    """The slow twin: cells that hold one of many sample points of a volume."""
    inside = (points[:, 2] >= grid.height) & (points[:, 2] <= grid.height + height)
    index = np.floor((points[inside, :2] - (grid.x0, grid.y0)) / grid.resolution).astype(int)
    index = index[((index >= 0) & (index < grid.shape)).all(axis=1)]
    mask = grid.empty()
    mask[index[:, 0], index[:, 1]] = True
    return mask


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("shape", ["sphere", "box"])
def test_cells_of_a_shape_match_sampling(shape: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(12):
        if shape == "sphere":
            sphere = random_spheres(rng, 1)
            volume, directions = SweptVolume(spheres=sphere), rng.normal(size=(60_000, 3))
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            points = sphere[0, :3] + directions * (sphere[0, 3] * rng.random((60_000, 1)) ** (1 / 6))
        else:
            volume, corners = random_boxes(rng, 1), rng.uniform(-1.0, 1.0, (60_000, 3))
            faces = np.where(rng.random(corners.shape) < 0.3, np.sign(corners), corners)
            points = volume.box_centres[0] + (faces * volume.box_half_extents[0]) @ volume.box_axes[0].T
        mask, sampled = swept_mask(COARSE, volume, 0.12), cells_of_points(COARSE, points, 0.12)
        assert not (sampled & ~mask).any()
        # Cells that the samples missed are few: their points are rare at a shape's rim.
        assert (mask & ~sampled).sum() <= 8


def test_volumes_above_the_object_or_below_the_table_do_not_count() -> None:
    high = SweptVolume(spheres=np.array([[0.0, 0.0, 1.0, 0.05]]))
    low = SweptVolume(spheres=np.array([[0.0, 0.0, 0.6, 0.05]]))
    assert not swept_mask(GRID, high, height=0.15).any()
    assert swept_mask(GRID, high, height=0.25).any()
    assert not swept_mask(GRID, low, height=0.25).any()


def test_mask_of_joined_volumes_is_the_union() -> None:
    rng = np.random.default_rng(3)
    parts = [SweptVolume(spheres=random_spheres(rng, 5)), random_boxes(rng, 4), SweptVolume()]
    union = np.logical_or.reduce([swept_mask(GRID, part, 0.15) for part in parts])
    np.testing.assert_array_equal(swept_mask(GRID, join_volumes(parts), 0.15), union)


def test_footprints_are_discs_and_rectangles_grown_by_the_clearance() -> None:
    turned = np.array([math.cos(0.3), 0.0, 0.0, math.sin(0.3)])
    box = Body("object_01", "box", np.array([0.02, 0.04, 0.07]), np.array([0.1, 0.2, 0.82]), turned)
    lying = cylinder(-0.2, -0.3).at((-0.2, -0.3, 0.78), (math.cos(math.pi / 4), math.sin(math.pi / 4), 0.0, 0.0))
    for body, area in ((cylinder(0.0, 0.0), math.pi * 0.03**2), (box, 0.04 * 0.08), (lying, 0.06 * 0.16)):
        covered = footprint_mask(GRID, [body]).sum() * GRID.resolution**2
        assert area <= covered <= 1.6 * area
        grown = footprint_mask(GRID, [body], clearance=0.02)
        assert not (footprint_mask(GRID, [body]) & ~grown).any()
        distance = np.linalg.norm(GRID.centres()[grown] - body.position[:2], axis=1)
        assert distance.max() <= body.radius + 0.02 * math.sqrt(2) + GRID.resolution


@pytest.mark.parametrize("seed", range(5))
def test_the_cells_about_a_region_are_all_that_it_contains(seed: int) -> None:
    """Also where it reaches over the grid, or lies beside it."""
    rng = np.random.default_rng(seed)
    for yaw in (0.0, *rng.uniform(-3, 3, 20)):
        region = Region("tray", "table", tuple(rng.uniform(-0.6, 0.6, 2)), tuple(rng.uniform(0.01, 0.4, 2)), yaw)
        contained, near = GRID.empty(), GRID.cells_about(region.corners)
        contained[near] = region.contains_points(GRID.centres(near))
        np.testing.assert_array_equal(contained, region.contains_points(GRID.centres()))


def test_ngr_is_ngr1_and_ngr2() -> None:
    target, obstacles = (
        SweptVolume(
            spheres=random_spheres(np.random.default_rng(seed), 3), cylinders=np.array([[x, 0.1, 0.03, 0.75, 0.91]])
        )
        for seed, x in ((0, 0.1), (1, -0.2))
    )
    region = negative_goal_region(GRID, 0.16, target, [obstacles, SweptVolume()])
    np.testing.assert_array_equal(region.mask, region.ngr1 | region.ngr2)
    np.testing.assert_array_equal(region.ngr1, swept_mask(GRID, target, 0.16))
    np.testing.assert_array_equal(region.ngr2, swept_mask(GRID, obstacles, 0.16))
    np.testing.assert_array_equal(negative_goal_region(GRID, 0.16, target).mask, region.ngr1)
    assert not negative_goal_region(GRID, 0.16, SweptVolume()).mask.any()
    assert not region.ngr1.flags.writeable


def test_cylinders_are_discs_between_their_ends() -> None:
    standing = SweptVolume(cylinders=np.array([[0.05, -0.1, 0.03, 0.80, 0.96]]))
    np.testing.assert_array_equal(swept_mask(GRID, standing, 0.1), footprint_mask(GRID, [cylinder(0.05, -0.1)]))
    assert not swept_mask(GRID, standing, 0.04).any()
    assert not swept_mask(GRID, SweptVolume(cylinders=np.array([[0.0, 0.0, 0.03, 0.4, 0.7]])), 0.1).any()


def slow_is_free(grid: SupportGrid, mask: np.ndarray, locations: np.ndarray, radius: float) -> np.ndarray:
    """The slow twin: distance from each location to every set cell."""
    x_low, x_high, y_low, y_high = grid.extent
    low = grid.centres()[mask] - grid.resolution / 2
    free = []
    for x, y in locations:
        gap = np.maximum(np.maximum(low - (x, y), (x, y) - (low + grid.resolution)), 0.0)
        margin = min(x - x_low, x_high - x, y - y_low, y_high - y)
        free.append(margin >= radius and not (np.hypot(gap[:, 0], gap[:, 1]) < radius).any())
    return np.array(free)


def test_is_free_matches_its_slow_twin_and_the_drawn_dilation_agrees() -> None:
    rng = np.random.default_rng(5)
    mask = swept_mask(GRID, SweptVolume(spheres=random_spheres(rng, 12)), 0.15)
    locations = rng.uniform((-0.4, -0.55), (0.4, 0.55), (600, 2))
    free = is_free(GRID, mask, locations, 0.04)
    np.testing.assert_array_equal(free, slow_is_free(GRID, mask, locations, 0.04))
    assert 0 < free.sum() < len(free)
    blocked = dilated(GRID, mask, 0.04)
    assert not (mask & ~blocked).any()
    centres = GRID.centres()[~blocked]
    inner = (np.abs(centres) < (0.31, 0.46)).all(axis=1)
    assert is_free(GRID, mask, centres[inner], 0.04).all()


def test_order_is_far_first_within_the_workspace_then_near_first_beyond_it() -> None:
    candidates = placement_grid(TABLE)
    base = np.array([-0.9, 0.0])
    in_work = candidates[:, 0] < 0.0
    order = clearance_order(candidates, in_work, base)
    assert sorted(order) == list(range(25))
    first, rest = order[: in_work.sum()], order[in_work.sum() :]
    assert in_work[first].all()
    assert not in_work[rest].any()
    distance = np.linalg.norm(candidates - base, axis=1)
    assert (np.diff(distance[first]) <= 1e-12).all()
    assert (np.diff(distance[rest]) >= -1e-12).all()
