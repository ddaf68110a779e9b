"""Motions of a base that turns where it stands and drives straight."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from assets import FETCH
from planners.motion.base import driveable
from planners.motion.path import on_base
from planners.motion.timing import time_parametrise
from planners.motion.trajectory import CONTROL_STEP, Phase

TURNING = FETCH.differential()


def test_every_part_of_a_way_is_a_turn_or_a_drive_along_the_heading() -> None:
    rng = np.random.default_rng(0)
    for _ in range(30):
        waypoints = rng.uniform(-2, 2, (rng.integers(2, 6), 3))
        way = driveable(TURNING, waypoints)
        np.testing.assert_array_equal(way[[0, -1]], waypoints[[0, -1]])
        for here, there in pairwise(way):
            moved = there[:2] - here[:2]
            if np.hypot(*moved) > 1e-9:
                assert here[2] == there[2]
                assert abs(np.cos(here[2]) * moved[1] - np.sin(here[2]) * moved[0]) < 1e-9
        assert driveable(FETCH, waypoints) is waypoints


def test_its_trajectory_is_at_rest_between_the_parts_and_keeps_the_limits() -> None:
    way = driveable(TURNING, np.array(((0.0, 0.0, 0.2), (-0.4, 0.1, 0.0), (-0.5, 0.7, 0.4))))
    trajectory = time_parametrise(on_base(way, np.array(FETCH.home)), TURNING, 0.0, Phase("drive", 0.0))
    base = trajectory.states[:, :3]
    moves = np.diff(base, axis=0)
    sideways = np.cos(base[:-1, 2]) * moves[:, 1] - np.sin(base[:-1, 2]) * moves[:, 0]
    assert np.abs(sideways).max() < 1e-9
    assert not (np.hypot(*moves[:, :2].T) * np.abs(moves[:, 2]) > 1e-9).any(), "it never turns while it drives"
    assert (np.abs(moves) <= np.array(FETCH.max_velocity[:3]) * CONTROL_STEP * (1 + 1e-6)).all()
    np.testing.assert_allclose(base[-1], way[-1])
