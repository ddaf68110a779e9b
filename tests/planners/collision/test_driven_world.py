"""One check in the world of a drive finds what checks all along the drive find."""

from __future__ import annotations

import numpy as np
import pytest

from planners.collision.driven_world import Drive, Extents
from planners.collision.world import CollisionWorld
from planners.scene import SELF_BIT, STATIC_BIT
from tests.planners.scenes import random_shelf

OPENING = 0.08


@pytest.mark.parametrize("direction", [(-1.0, 0.0), (-0.8, 0.6)])
@pytest.mark.parametrize("offset", [(0.0, 0.0), (-0.06, 0.08)])
def test_what_a_straight_drive_hits_is_hit_in_its_world(
    direction: tuple[float, float], offset: tuple[float, float]
) -> None:
    world = CollisionWorld.from_scene(random_shelf(12, 4))
    drive = Drive(np.array(offset), np.array(direction), 0.5, 0.0)
    driven = Extents.of(world, drive.direction).driven_world(drive)
    rng, found = np.random.default_rng(0), []
    for _ in range(400):
        base = np.array([rng.uniform(-1.0, -0.6), rng.uniform(-0.4, 0.4), rng.uniform(-0.6, 0.6)])
        q = rng.uniform(np.maximum(world.robot.lower, -2.0), np.minimum(world.robot.upper, 2.0))
        start = np.concatenate((base, q))
        start[:2] += offset
        end = start.copy()
        end[:2] += drive.distance * drive.direction
        along = world.path_hits(np.stack((start, end)), OPENING)
        if along >> SELF_BIT & 1:
            continue
        once = driven.hits(base, q, OPENING) | world.hits(start[:3], q, OPENING)
        assert along & ~once == 0
        found.append((along, driven.hits(base, q, OPENING)))
    free = [along == 0 for along, _ in found]
    assert 10 < sum(free) < len(free)
    if abs(direction[0]) == 1.0 and offset == (0.0, 0.0):  # then the answer is exact for static obstacles
        assert all((along ^ once) >> STATIC_BIT & 1 == 0 for along, once in found)


def test_an_object_that_is_left_standing_counts_as_static() -> None:
    scene = random_shelf(1, 0)
    world, body = CollisionWorld.from_scene(scene), scene.objects[0]
    drive = Drive(np.zeros(2), np.array([-1.0, 0.0]), 0.3, 0.0)
    extents = Extents.of(world, drive.direction)
    driven, without = extents.driven_world(drive, body), extents.driven_world(drive)
    assert len(driven.obstacles.static.core) == len(without.obstacles.static.core) + 1
