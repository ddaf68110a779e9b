"""Lines of sight: the kernels against slow twins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planners.scene import StaticObstacle
from planners.search.sight import FIXED, Screens, between, carve
from tests.planners.scenes import OBSTACLES, random_scene

Array = NDArray[np.float64]


def _between_twin(eye: Array, points: Array, screens: Screens) -> NDArray[np.int64]:
    """The same by looking at 4000 points of every segment."""
    shares = (np.arange(4000) + 0.5)[:, None] / 4000
    found = np.zeros(len(points), np.int64)
    for n, point in enumerate(points):
        on_line = eye + shares * (point - eye)
        for position, rotation, half, is_round, bit in zip(*screens, strict=True):
            local = (on_line - position) @ rotation
            is_in = np.abs(local) < half
            if is_round:
                is_in[:, 0] = np.hypot(local[:, 0], local[:, 1]) < half[0]
            if is_in.all(axis=1).any():
                found[n] |= bit
    return found


def test_what_is_between_an_eye_and_points() -> None:
    rng, scene = np.random.default_rng(0), random_scene(12, 3)
    screens = Screens.of(scene.objects, OBSTACLES)
    points = np.column_stack((rng.uniform(-0.35, 0.35, 60), rng.uniform(-0.5, 0.5, 60), rng.uniform(0.76, 0.9, 60)))
    eye = np.array([-1.2, 0.1, 1.2])
    found, wanted = between(eye, points, screens), _between_twin(eye, points, screens)
    assert (found != wanted).mean() < 0.05  # the twin misses what it crosses for less than its step
    assert ((found & wanted) == wanted).all()
    assert 0 < (found == 0).sum() < len(found)


def test_furniture_is_one_bit_and_a_turned_box_counts_as_it_stands() -> None:
    c, s = np.cos(0.6), np.sin(0.6)
    board = StaticObstacle("board", (0.5, 0, 0), (0.01, 0.2, 0.3), "box", np.array(((c, -s, 0), (s, c, 0), (0, 0, 1))))
    points = np.array([(1.0, 0.0, 0.0), (1.0, 0.45, 0.0), (0.3, 0.0, 0.0)])
    assert between(np.zeros(3), points, Screens.of((), (board,))).tolist() == [FIXED, 0, 0]


def _carve_twin(
    is_unseen: NDArray[np.bool_], origin: Array, cell: Array, depth: NDArray[np.float32], K: Array, T: Array
) -> NDArray[np.bool_]:
    centres = origin + (np.stack(np.indices(is_unseen.shape), axis=-1) + 0.5) * cell
    local = centres @ T[:3, :3].T + T[:3, 3]
    ahead = local[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.floor(K[0, 0] * local[..., 0] / ahead + K[0, 2] + 0.5)
        v = np.floor(K[1, 1] * local[..., 1] / ahead + K[1, 2] + 0.5)
    in_image = (ahead >= 0.05) & (u >= 0) & (u < depth.shape[1]) & (v >= 0) & (v < depth.shape[0])
    seen = np.zeros_like(is_unseen)
    seen[in_image] = ahead[in_image] < depth[v[in_image].astype(int), u[in_image].astype(int)] - 0.01
    return is_unseen & ~seen


def test_cells_before_what_is_seen_are_cleared() -> None:
    rng = np.random.default_rng(1)
    depth = rng.uniform(0.3, 2.0, (40, 60)).astype(np.float32)
    K = np.array(((50.0, 0, 29.5), (0, 50.0, 19.5), (0, 0, 1)))
    T = np.eye(4)
    T[:3, 3] = 0.1, -0.2, 0.4
    unseen, origin, cell = rng.random((20, 30, 10)) < 0.9, np.array([-0.6, -0.5, -0.5]), np.array([0.05, 0.04, 0.15])
    wanted = _carve_twin(unseen, origin, cell, depth, K, T)
    before = int(unseen.sum())
    assert carve(unseen, origin, cell, depth, K, T, 0.01, 1.0, 1.0) == before - int(wanted.sum()) > 0
    assert (unseen == wanted).all()


def test_coarse_pixels_clear_no_cell_that_something_between_them_may_hide() -> None:
    """With images of 64 pixels two of four hidden targets "could not be found": pixels showed what is beside them."""
    K, cell = np.array(((50.0, 0, 1.5), (0, 50.0, 1.5), (0, 0, 1))), np.full(3, 0.001)
    depth = np.full((4, 4), 3.0, np.float32)
    depth[2, 2] = 1.0
    for u, nearest, around in ((2.0, 0, 0), (2.6, 1, 0), (0.4, 1, 1)):
        origin = np.array(((u - 1.5) * 2.0 / 50, 0.5 * 2.0 / 50, 2.0)) - cell / 2  # 2 m away a pixel is 0.04 m wide
        cleared = [
            carve(np.ones((1, 1, 1), np.bool_), origin, cell, depth, K, np.eye(4), 0.01, *widths)
            for widths in ((0.05, 0.05), (0.03, 0.05), (0.03, 0.035))
        ]
        assert cleared == [nearest, around, 0]
