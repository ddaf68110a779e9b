"""Objects are placed as a plain rejection sampler places them, draw by draw."""

from __future__ import annotations

import numpy as np
import pytest

from clutter_env.scene.layout import LAYOUTS, Layout
from clutter_env.scene.object_sets import OBJECT_GAP, OBJECT_SETS
from clutter_env.scene.random_scene import sample_scene


def place_plainly(rng: np.random.Generator, layout: Layout, radii: np.ndarray) -> np.ndarray:
    """One attempt: batches of candidates, all tested against all objects placed so far."""
    high = np.array([layout.depth, layout.width]) / 2 - OBJECT_SETS["standard"].edge_margin
    positions = np.empty((len(radii), 2))
    for index, radius in enumerate(radii):
        while True:
            candidates = rng.uniform(-high, high, (128 if index > 10 else 8, 2))
            offset = candidates[:, None, :] - positions[:index]
            is_free = ((offset**2).sum(axis=2) > (radii[:index] + (radius + OBJECT_GAP)) ** 2).all(axis=1)
            if is_free.any():
                positions[index] = candidates[is_free.argmax()]
                break
    return positions


@pytest.mark.parametrize("count", [0, 1, 11, 20, 40, 60])
@pytest.mark.parametrize("seed", range(2))
def test_positions_equal_those_of_a_plain_sampler(count: int, seed: int) -> None:
    layout = LAYOUTS["paper"]
    scene = sample_scene(np.random.default_rng(seed), layout, count)
    rng = np.random.default_rng(seed)
    for _ in range(4):  # the sizes, drawn before the positions
        rng.random(count)
    expected = place_plainly(rng, layout, scene.half_extents[:, 0])
    assert np.array_equal(scene.positions, expected)
