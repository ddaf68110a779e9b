"""Base poses of a base that is not round: its outline keeps clear of obstacles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from assets.robots import FETCH, PR2
from planners.grasping.base_placement import fits, inner_radius

TABLE = np.array([(-0.35, -0.5), (0.35, -0.5), (0.35, 0.5), (-0.35, 0.5)])
HALF = 0.334
"""[m] of PR2's square base."""


def test_the_inner_circle_touches_the_sides() -> None:
    assert inner_radius(PR2) == pytest.approx(HALF)
    assert inner_radius(FETCH) == FETCH.base_radius


def test_a_square_stands_nearer_with_a_side_than_with_a_corner_ahead() -> None:
    nearest, corner = -0.35 - HALF, -0.35 - HALF * np.sqrt(2.0)
    straight, turned = 0.0, np.pi / 4
    bases = np.array([(nearest - 0.021, 0, straight), (nearest - 0.019, 0, straight), (nearest - 0.021, 0, turned)])
    assert fits(PR2, bases, [TABLE], 0.02).tolist() == [True, False, False]
    bases = np.array([(corner - 0.021, 0, turned), (corner - 0.019, 0, turned), (0.0, 0.0, 0.0)])
    assert fits(PR2, bases, [TABLE], 0.02).tolist() == [True, False, False]


def test_what_fits_is_apart_and_what_does_not_is_near() -> None:
    """Against distances between points on the outlines."""
    rng = np.random.default_rng(0)
    bases = np.column_stack((rng.uniform(-1.3, -0.6, 200), rng.uniform(-1.2, 1.2, 200), rng.uniform(-3.2, 3.2, 200)))
    corners, table = _points(np.array(PR2.base_outline)), _points(TABLE)
    answers = fits(PR2, bases, [TABLE], 0.02)
    for base, answer in zip(bases, answers, strict=True):
        c, s = np.cos(base[2]), np.sin(base[2])
        placed = corners @ np.array([(c, s), (-s, c)]) + base[:2]
        distance = np.linalg.norm(placed[:, None] - table[None], axis=-1).min()
        if answer:
            assert distance > 0.02 - 1e-9
        else:
            assert distance < 0.02 * np.sqrt(2.0) + 0.01, "the margin is measured across the edges"


def _points(corners: np.ndarray, count: int = 60) -> np.ndarray:
    """Points along the edges of a polygon, the corners among them."""
    shares = np.linspace(0.0, 1.0, count, endpoint=False)[:, None]
    ends = np.roll(corners, -1, axis=0)
    return np.concatenate([a + shares * (b - a) for a, b in zip(corners, ends, strict=True)])


def test_a_round_base_always_fits_where_its_circle_does() -> None:
    assert fits(FETCH, np.zeros((3, 3)), [TABLE], 0.02).all()
    assert fits(replace(FETCH, base_outline=PR2.base_outline), np.zeros((0, 3)), [TABLE], 0.02).shape == (0,)
