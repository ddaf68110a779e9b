"""Perception: points of a surface become the object that they are of."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from planners.scene import StaticObstacle
from planners.search.perception import Description, Seen, fit_upright, of_one_colour, perceive
from tests.planners.scenes import HEIGHT, OBSTACLES

Array = NDArray[np.float64]
_SUPPORTS: list[StaticObstacle] = [OBSTACLES[0]]


def _seen_from_the_front(shape: str, half: Array, yaw: float, noise: float, rng: np.random.Generator) -> Array:
    """Points of the top and of the sides that face (-x), as a camera in front of the table sees them."""
    x, y = rng.uniform(-1, 1, (2, 600))
    angle = rng.uniform(-np.pi, np.pi, 900)
    rim = np.column_stack((np.cos(angle), np.sin(angle)))
    if shape == "box":
        top = np.column_stack((x, y)) * half[:2]
        sides = rim / np.abs(rim).max(axis=1)[:, None] * half[:2]
    else:
        top = (np.column_stack((x, y)) * half[:2])[np.hypot(x, y) < 1]
        sides = rim * half[:2]
    turn = np.array(((np.cos(yaw), -np.sin(yaw)), (np.sin(yaw), np.cos(yaw))))
    top, sides = top @ turn.T, sides @ turn.T
    # A side faces the camera where the way on from it to the camera leaves the object: here, its nearer half.
    sides = sides[sides[:, 0] < 0]
    points = np.vstack(
        (
            np.column_stack((top, np.full(len(top), 2 * half[2]))),
            np.column_stack((sides, rng.uniform(0, 2 * half[2], len(sides)))),
        )
    )
    return points + (0.1, -0.2, HEIGHT) + noise * rng.standard_normal(points.shape)


@pytest.mark.parametrize("noise", [0.0, 0.004])
@pytest.mark.parametrize(("shape", "half"), [("cylinder", (0.03, 0.03, 0.08)), ("box", (0.022, 0.028, 0.07))])
def test_shape_size_and_place_are_found(shape: str, half: tuple[float, ...], noise: float) -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        points = _seen_from_the_front(shape, np.array(half), rng.uniform(-1, 1), noise, rng)
        body, sigma = fit_upright("it", points, _SUPPORTS)
        away = float(np.linalg.norm(body.position[:2] - (0.1, -0.2)))
        assert away < min(0.002 + noise, 3 * sigma)
        assert np.abs(np.sort(body.half_extents[:2]) - np.sort(half[:2])).max() < 0.003 + 1.5 * noise
        assert body.bottom == pytest.approx(HEIGHT, abs=1e-9)
        assert abs(body.half_extents[2] - half[2]) < 0.001 + noise
        assert body.shape == shape or noise


def test_a_sliver_of_a_known_target_tells_its_place() -> None:
    """Its size is known, and a strip of it 1 cm wide is seen."""
    rng, half = np.random.default_rng(4), (0.03, 0.03, 0.06)
    points = _seen_from_the_front("cylinder", np.array(half), 0.0, 0.0, rng)
    strip = points[points[:, 1] > -0.2 + 0.02]
    body, _ = fit_upright("target", strip, _SUPPORTS, Description((1, 0, 0), "cylinder", half))
    assert np.linalg.norm(body.position[:2] - (0.1, -0.2)) < 0.006
    assert np.allclose(body.half_extents, half)


def test_two_parts_of_the_target_become_one_once_it_is_seen_whole() -> None:
    rng, target = np.random.default_rng(4), Description((1, 0, 0), "cylinder", (0.03, 0.03, 0.06))
    points = _seen_from_the_front("cylinder", np.array(target.half_extents), 0.0, 0.0, rng)
    parts = {"seen_00": points[points[:, 1] > -0.18], "seen_01": points[points[:, 1] < -0.22]}
    known = [
        Seen(fit_upright(name, part, _SUPPORTS, target)[0], part, np.array((1, 0, 0)), 0.0, True)
        for name, part in parts.items()
    ]
    image = {"masks": np.full((1, len(points)), 3), "colours": np.full((1, len(points), 3), (255, 0, 0))}
    view: Any = SimpleNamespace(**image, points=lambda _: points, eye=np.zeros(2))
    (found,) = perceive(view, known, _SUPPORTS, target)
    assert np.linalg.norm(found.body.position[:2] - (0.1, -0.2)) < 0.002
    for held in parts:
        assert held in [one.name for one in perceive(view, known, _SUPPORTS, target, held)]


@pytest.mark.parametrize(("shape", "half"), [("cylinder", (0.03, 0.03, 0.08)), ("box", (0.022, 0.028, 0.07))])
def test_what_is_seen_as_a_sliver_lies_behind_it(shape: str, half: tuple[float, ...]) -> None:
    """A strip 15 mm wide of the side that faces the camera, between two others: the object is not in front of it."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        points = _seen_from_the_front(shape, np.array(half), 0.0, 0.001, rng)
        at = rng.uniform(-0.01, 0.01) - 0.2
        strip = points[(points[:, 2] < HEIGHT + 2 * half[2] - 0.01) & (np.abs(points[:, 1] - at) < 0.0075)]
        body, _ = fit_upright("it", strip, _SUPPORTS, eye=np.array((-1.0, -0.2)))
        assert np.linalg.norm(body.position[:2] - (0.1, -0.2)) < 0.018
        assert body.half_extents[:2].min() >= 0.02


def _view_of(*masks: Array) -> Any:
    """A view whose masks, numbered from 3 on, show these points (n, 3) in green and blue."""
    numbers = np.repeat(np.arange(len(masks)), [len(points) for points in masks])
    every = np.concatenate(masks)
    colours = 255 * np.eye(3)[1 + numbers % 2]
    image = {"masks": 3 + numbers[None], "colours": colours[None], "eye": np.array((-1.0, 0.0))}
    return SimpleNamespace(**image, points=lambda mask: every[mask[0]])


def test_masks_that_run_into_each_other_change_nothing_and_one_that_was_two_is_parted() -> None:
    rng, target = np.random.default_rng(4), Description((1, 0, 0), "cylinder", (0.02, 0.02, 0.05))
    one = _seen_from_the_front("cylinder", np.array((0.03, 0.03, 0.06)), 0.0, 0.001, rng)
    other = one + (0.0, 0.08, 0.0)
    both = np.concatenate((one[::2], other[::3]))
    known = perceive(_view_of(one, other), (), _SUPPORTS, target)
    assert len(known) == 2
    for before, after in zip(known, perceive(_view_of(both), known, _SUPPORTS, target), strict=True):
        np.testing.assert_array_equal(before.body.half_extents, after.body.half_extents)
    joined = perceive(_view_of(both), (), _SUPPORTS, target)
    assert len(joined) == 1
    parted = perceive(_view_of(one, other), joined, _SUPPORTS, target)
    places = sorted(tuple(np.round(seen.body.position[:2], 2)) for seen in parted)
    assert places == [(0.1, -0.2), (0.1, -0.12)]


def test_what_is_in_the_hand_is_no_other_object() -> None:
    """It hangs above the table, 2 cm from where it was when the fingers closed."""
    rng, target = np.random.default_rng(4), Description((1, 0, 0), "cylinder", (0.02, 0.02, 0.05))
    points = _seen_from_the_front("cylinder", np.array((0.03, 0.03, 0.06)), 0.0, 0.001, rng)
    (known,) = perceive(_view_of(points), (), _SUPPORTS, target)
    in_hand = replace(known, body=known.body.at(known.body.position + (0.0, 0.0, 0.4)))
    assert perceive(_view_of(points + (0.0, 0.02, 0.4)), (in_hand,), _SUPPORTS, target, known.name) == (in_hand,)


def test_of_a_mask_what_has_its_colour_counts() -> None:
    """A ragged edge takes in the table; a mask that runs into a neighbour's takes in all of that."""
    rng, mask = np.random.default_rng(0), np.zeros((40, 40), bool)
    mask[10:30, 15:25] = True
    colours = np.full((40, 40, 3), (200, 160, 120))  # wood
    colours[mask] = (20, 60, 30) + rng.integers(0, 3, (mask.sum(), 1)) * np.array((10, 30, 15))  # one green in shades
    colours[10:30, 25:33] = (30, 40, 200)
    ragged = mask | (ndimage.binary_dilation(mask, iterations=2) & (rng.random(mask.shape) < 1 / 4))
    ragged[10:30, 25:33] = True
    assert (of_one_colour(ragged, colours) == mask).all()


def test_colours_are_compared_in_any_shade() -> None:
    target = Description.of((0.87, 0.12, 0.1, 1.0, 0.02, 0.03, 0.06))
    assert (target.shape, target.height, target.radius) == ("box", 0.12, 0.02)
    assert target.has_colour(0.4 * np.array(target.colour))
    assert not target.has_colour(np.array((0.8, 0.6, 0.1)))
