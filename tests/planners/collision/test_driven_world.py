"""One check in the world of a drive finds what checks all along the drive find."""

from __future__ import annotations

import numpy as np
import pytest

from planners.collision.driven_world import drive_worlds
from planners.collision.world import CollisionWorld
from planners.scene import SELF_BIT, STATIC_BIT
from tests.planners.scenes import random_shelf

OPENING = 0.08


@pytest.mark.parametrize("direction", [(-1.0, 0.0), (-0.8, 0.6)])
def test_what_a_straight_drive_hits_is_hit_in_its_worlds(direction: tuple[float, float]) -> None:
    world, distance = CollisionWorld.from_scene(random_shelf(12, 4)), 0.5
    inside, driven = drive_worlds(world, np.array(direction), distance, 0.0)
    rng, found = np.random.default_rng(0), []
    for _ in range(400):
        base = np.array([rng.uniform(-1.0, -0.6), rng.uniform(-0.4, 0.4), rng.uniform(-0.6, 0.6)])
        q = rng.uniform(np.maximum(world.robot.lower, -2.0), np.minimum(world.robot.upper, 2.0))
        start = np.concatenate((base, q))
        end = start.copy()
        end[:2] += distance * np.array(direction)
        along = world.path_hits(np.stack((start, end)), OPENING)
        if along >> SELF_BIT & 1:
            continue
        once = driven.hits(base, q, OPENING) | inside.hits(base, q, OPENING)
        assert along & ~once == 0
        found.append((along, driven.hits(base, q, OPENING)))
    free = [along == 0 for along, _ in found]
    assert 10 < sum(free) < len(free)
    if abs(direction[0]) == 1.0:  # then the answer is exact for static obstacles
        assert all((along ^ once) >> STATIC_BIT & 1 == 0 for along, once in found)


def test_an_object_that_is_left_standing_counts_as_static() -> None:
    scene = random_shelf(1, 0)
    world, body = CollisionWorld.from_scene(scene), scene.objects[0]
    with_it, without = (drive_worlds(world, np.array([-1.0, 0.0]), 0.3, 0.0, left) for left in (body, None))
    assert len(with_it.driven.obstacles.static.core) == len(without.driven.obstacles.static.core) + 1
