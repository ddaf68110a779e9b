"""Ranges of angles contain every solution for every value of what is known up to an error."""

from __future__ import annotations

import numpy as np

from irm.ik.ranges import away_and_around, component_range, direction, distance_range, meeting_ranges, within
from irm.ik.subproblems import angles_to_component, angles_to_distance, angles_to_meet

SPARE = 1e-7


def unit(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def hard_unit(rng, near):
    """A unit vector, often along, opposite to, or at a right angle to another one, exactly or nearly."""
    v, kind = unit(rng), rng.integers(5)
    v = (v, near, -near, v - near * (near @ v), near + 1e-4 * v)[kind]
    return v / np.linalg.norm(v)


def is_in(angle, middle, half):
    return abs((angle - middle + np.pi) % (2 * np.pi) - np.pi) <= half + SPARE


def test_a_range_within_limits_keeps_every_angle_that_is_within_both():
    rng = np.random.default_rng(0)
    for _ in range(3000):
        middle, half = rng.uniform(-7, 7), rng.choice([0.0, rng.uniform(0, 3.3)])
        lower = rng.uniform(-4, 2)
        upper = lower + rng.choice([0.0, rng.uniform(0, 7)])
        kept = within(middle, half, lower, upper)
        for angle in middle + half * np.array([-1.0, 1.0, *rng.uniform(-1, 1, 5)]):
            if any(lower <= angle + turn <= upper for turn in 2 * np.pi * np.arange(-3, 4)):
                assert is_in(angle, *kept)
    assert within(1.0, 0.1, 2.0, 3.0)[1] < 0.0
    np.testing.assert_allclose(within(2.0, 0.5, 2.0, 3.0), (2.25, 0.25), atol=1e-6)


def test_distances_and_components_within_an_error_have_their_angles_in_the_range():
    rng = np.random.default_rng(1)
    for _ in range(3000):
        axis = unit(rng)
        fixed, moved = 0.5 * hard_unit(rng, axis), 0.4 * hard_unit(rng, axis)
        distance, error = rng.uniform(0.0, 1.0), 10 ** rng.uniform(-9, -1)
        middle, least, most = distance_range(axis, fixed, moved, max(0.0, distance - error), distance + error)
        first, second, missed = angles_to_distance(axis, fixed, moved, distance + error * rng.uniform(-1, 1))
        if missed == 0.0 and np.linalg.norm(np.cross(axis, moved)) > 1e-4 < np.linalg.norm(np.cross(axis, fixed)):
            for angle in (first, second):
                away = abs((angle - middle + np.pi) % (2 * np.pi) - np.pi)
                assert least - SPARE <= away <= most + SPARE
        other, value = unit(rng), rng.uniform(-0.4, 0.4)
        middle, least, most = component_range(other, axis, moved, value, error)
        first, second, missed = angles_to_component(other, axis, moved, value + error * rng.uniform(-1, 1))
        if missed == 0.0:
            for angle in (first, second):
                away = abs((angle - middle + np.pi) % (2 * np.pi) - np.pi)
                assert least - SPARE <= away <= most + SPARE or np.linalg.norm(np.cross(axis, moved)) < 1e-4


def test_directions_that_move_meet_at_angles_in_the_ranges():
    """The axes are at right angles, nearly or not; the vectors lie along them, at right angles to them, or anywhere."""
    rng, met = np.random.default_rng(2), 0
    for _ in range(6000):
        axis_1 = unit(rng)
        axis_2 = unit(rng) if rng.random() < 0.3 else np.cross(axis_1, unit(rng))
        axis_2 = axis_2 / np.linalg.norm(axis_2)
        starts, moved = [], []
        for axis, reference in ((axis_1, axis_2), (axis_2, axis_1)):
            v = hard_unit(rng, axis)
            away, around = (np.array(side) for side in away_and_around(axis, v))
            size = 10 ** rng.uniform(-8, -0.3, 3)
            starts.append(direction(axis, reference, v, *size))
            side = rng.uniform(-1, 1, 2) * size[:2]
            moved.append(v + side[0] * away + side[1] * around + rng.uniform(0, 1) * size[2] * unit(rng))
        ranges = meeting_ranges(axis_1, starts[0], axis_2, starts[1])
        a, b, other_a, other_b, missed, _ = angles_to_meet(axis_1, moved[0], axis_2, moved[1])
        if missed > 1e-12:
            continue
        met += 1
        for sign, (angle_1, angle_2) in ((1.0, (a, b)), (-1.0, (other_a, other_b))):
            assert ranges.half_1 >= 0.0
            # the range is about the way from `v`; the angle from where `v` has moved to: both are within the azimuth's
            assert is_in(angle_1, sign * ranges.side_1 - ranges.azimuth_1, ranges.half_1)
            assert is_in(angle_2, -sign * ranges.side_2 - ranges.azimuth_2, ranges.half_2)
    assert met > 1000
