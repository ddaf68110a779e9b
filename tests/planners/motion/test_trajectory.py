"""Timed motions: limits in every sample, rest at the ends, on the path, phases in order."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from assets.robots import FETCH
from planners.collision.world import CollisionWorld
from planners.motion import timing
from planners.motion.path import WholeBodyPath, cut, interpolate
from planners.motion.pick_and_place import PickPlaceMotion, plan_pick, plan_place
from planners.motion.timing import _SLOW, drive_trajectory, pick_trajectory, place_trajectory, time_parametrise
from planners.motion.trajectory import CONTROL_STEP, Phase, Trajectory, join
from planners.scene import HeldObject, RobotState, StaticObstacle
from tests.planners.motion_scenes import grasp_configurations
from tests.planners.scenes import cylinder, table_scene

HOME = np.array(FETCH.home)
VELOCITY, ACCELERATION = np.array(FETCH.max_velocity), np.array(FETCH.max_acceleration)
STATE = RobotState(np.array([-1.1, 0.0, 0.0]), HOME, FETCH.max_finger_position)


def rates(trajectory: Trajectory) -> np.ndarray:
    """(n - 1, 11) velocities between samples, the base's in its own frame."""
    X = np.hstack([trajectory.base, trajectory.q])
    velocity = np.diff(X, axis=0) / CONTROL_STEP
    c, s = np.cos(X[:-1, 2]), np.sin(X[:-1, 2])
    velocity[:, :2] = np.column_stack(
        [c * velocity[:, 0] + s * velocity[:, 1], c * velocity[:, 1] - s * velocity[:, 0]]
    )
    return velocity


def assert_within_limits(trajectory: Trajectory) -> None:
    velocity = rates(trajectory)
    padded = np.vstack([np.zeros(11), velocity, np.zeros(11)])
    assert (np.abs(velocity) <= VELOCITY).all()
    assert (np.abs(np.diff(padded, axis=0)) / CONTROL_STEP <= ACCELERATION).all()
    assert (np.abs(np.diff(trajectory.finger_position)) <= FETCH.max_finger_velocity * CONTROL_STEP + 1e-12).all()
    assert np.allclose(np.diff(trajectory.times), CONTROL_STEP)


def random_polygon(rng: np.random.Generator) -> np.ndarray:
    """Some corners anywhere, then a finely cut curve."""
    lower = np.array([-1.5, -0.5, -0.7, *(link.lower for link in FETCH.chain)])
    upper = np.array([-0.7, 0.5, 0.7, *(link.upper for link in FETCH.chain)])
    corners = rng.uniform(lower, upper, (rng.integers(2, 6), 11))
    t = np.linspace(0, 1, 25)[1:, None]
    return np.vstack([corners, corners[-1] + t * rng.normal(0, 0.1, 11) + 0.1 * np.sin(3 * t)])


@pytest.mark.parametrize("seed", range(4))
def test_limits_hold_in_every_sample_and_the_path_is_kept(seed: int) -> None:
    X = random_polygon(np.random.default_rng(seed))
    trajectory = time_parametrise(X, FETCH, 0.02, Phase("drive", 0.0))
    assert_within_limits(trajectory)
    samples = np.hstack([trajectory.base, trajectory.q])
    assert np.allclose(samples[0], X[0])
    assert np.allclose(samples[-1], X[-1])
    for x in samples:
        away = [
            np.abs(x - (a + np.clip((x - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1) * (b - a))).max()
            for a, b in itertools.pairwise(X)
        ]
        assert min(away) < 1e-6


def test_a_single_move_takes_about_the_least_time() -> None:
    """A trapezoid of speed for the slowest joint, up to rounding to control steps and the headroom kept."""
    for joint, distance in ((0, 1.5), (2, 1.0), (3, 0.2), (4, 2.0), (10, 0.1)):
        X = np.zeros((2, 11))
        X[1, joint] = distance
        v, a = VELOCITY[joint], ACCELERATION[joint]
        least = distance / v + v / a if distance > v * v / a else 2 * np.sqrt(distance / a)
        duration = time_parametrise(X, FETCH, 0.0, Phase("drive", 0.0)).duration
        assert least <= duration + 1e-9
        assert duration <= 1.45 * least + 3 * CONTROL_STEP


def test_a_loaded_base_turns_slowly() -> None:
    X = np.zeros((2, 11))
    X[1, 2], X[:, 3:] = 2.0, HOME
    world = CollisionWorld.from_scene(table_scene())
    path = WholeBodyPath(X, 0.0, HeldObject("object_00", np.eye(4)))
    trajectory = drive_trajectory(world, path, STATE)
    assert np.abs(rates(trajectory)[:, 2]).max() <= FETCH.max_loaded_yaw_rate
    assert trajectory.held == "object_00"
    assert drive_trajectory(world, WholeBodyPath(X, 0.0), STATE).duration < trajectory.duration


def test_beside_a_wall_the_robot_moves_and_brakes_slowly() -> None:
    """At full speed it overshoots by more than planned paths keep from walls."""
    scene = table_scene()
    for gap, is_beside in ((0.004, True), (0.02, False)):
        ahead = -1.1 + 0.6 + FETCH.base_radius + gap
        obstacle = StaticObstacle("box", np.array([ahead + 0.05, 0.0, 0.1]), np.array([0.05, 0.5, 0.1]))
        world = CollisionWorld.from_scene(replace(scene, static_obstacles=(obstacle,)))
        X = np.zeros((2, 11))
        X[:, 0], X[:, 3:] = (-1.1, -0.5), HOME
        trajectory = drive_trajectory(world, WholeBodyPath(X, 0.0), STATE)
        speed = np.abs(rates(trajectory)[:, 0])
        braking = -np.diff(np.append(speed, 0.0))[-3:].min() / CONTROL_STEP
        assert (braking <= 1.5 * _SLOW**2 * ACCELERATION[0]) == is_beside
        assert speed.max() > _SLOW * VELOCITY[0]
        assert_within_limits(trajectory)


def test_samples_interpolate_and_are_clipped_and_ragged_ones_are_refused() -> None:
    rows = np.array([np.full(12, a) for a in (0.0, 0.2)])
    trajectory = Trajectory.of_states(rows, Phase("drive", 0.0))
    assert np.allclose(trajectory.sample(CONTROL_STEP / 2).q, 0.1)
    assert np.array_equal(trajectory.sample(-1.0).base, trajectory.base[0])
    assert np.array_equal(trajectory.sample(1e9).base, trajectory.base[-1])
    with pytest.raises(ValueError, match="samples"):
        Trajectory(np.zeros(3), rows[:, :3], rows[:, 3:11], rows[:, 11], trajectory.phases)
    with pytest.raises(ValueError, match="phases"):
        Trajectory(trajectory.times, rows[:, :3], rows[:, 3:11], rows[:, 11], ())


def test_joined_trajectories_keep_their_order_and_times() -> None:
    pieces = [
        time_parametrise(np.array([np.full(11, a), np.full(11, a + 0.2)]), FETCH, 0.0, Phase(str(a), 0.0))
        for a in (0.0, 0.2)
    ]
    whole = join(pieces)
    assert whole.duration == pytest.approx(pieces[0].duration + pieces[1].duration)
    assert [phase.name for phase in whole.phases] == ["0.0", "0.2"]
    assert whole.phase(pieces[0].duration - 0.01).name == "0.0"
    assert whole.phase(pieces[0].duration + 0.01).name == "0.2"
    assert_within_limits(whole)


def test_picking_and_placing_in_time() -> None:
    scene = table_scene(cylinder("object_00", -0.15, 0.0), cylinder("object_01", 0.1, 0.3))
    world, rng = CollisionWorld.from_scene(scene), np.random.default_rng(0)
    base, q = grasp_configurations(world, "object_00", rng)[0]
    pick = plan_pick(world, base, HOME, q, "object_00", rng=rng)
    assert isinstance(pick, PickPlaceMotion)
    place = plan_place(world, base, pick.retreat.end, q, pick.held, rng=rng)
    assert isinstance(place, PickPlaceMotion)
    taking = pick_trajectory(world, pick, RobotState(base, HOME, FETCH.max_finger_position))
    putting = place_trajectory(world, place, RobotState(base, pick.retreat.end, float(taking.finger_position[-1])))
    for trajectory in (taking, putting):
        assert_within_limits(trajectory)
    assert (taking.held, putting.held) == ("object_00", "")
    assert [p.name for p in taking.phases] == ["ready", "transit", "approach", "close", "lift", "retreat"]
    assert [p.name for p in putting.phases] == ["transit", "lower", "open", "rise", "retreat"]
    closing = (taking.times >= taking.phases[3].start) & (taking.times <= taking.phases[4].start)
    assert np.ptp(taking.q[closing], axis=0).max() == 0.0
    assert np.allclose(putting.q[0], taking.q[-1])


def test_interpolation_of_all_columns_is_that_of_each() -> None:
    rng = np.random.default_rng(0)
    for count in (1, 2, 3, 20):
        parts, points = rng.integers(1, 9, count), rng.normal(size=(count + 1, 11))
        at = cut(parts)
        assert np.array_equal(at, [0.0, *(i + k / n for i, n in enumerate(parts) for k in range(1, n + 1))])
        for knots in (np.arange(count + 1), np.cumsum(rng.uniform(0.1, 1.0, count + 1)), np.zeros(count + 1)):
            places = np.interp(at, np.arange(count + 1), knots)
            here = points[:1].repeat(count + 1, axis=0) if not knots.any() else points
            alone = np.column_stack([np.interp(places, knots, column) for column in here.T])
            assert np.array_equal(interpolate(places, knots, here), alone)


def twin_speeds(length: np.ndarray, points: np.ndarray, acceleration: np.ndarray, is_slow: np.ndarray) -> np.ndarray:
    """NumPy twin of the kernel that computes speeds."""

    def share(vectors: np.ndarray) -> np.ndarray:
        planar = np.hypot(vectors[:, 0], vectors[:, 1]) / acceleration[:2].min()
        return np.maximum(planar, (np.abs(vectors[:, 2:]) / acceleration[2:]).max(axis=1))

    steps, slower = np.diff(length), np.where(is_slow, timing._SLOW**2, 1.0)
    direction = np.diff(points, axis=0) / steps[:, None]
    turn, mean = np.maximum(share(np.diff(direction, axis=0)), timing._TINY), 0.5 * (steps[:-1] + steps[1:])
    swing = np.hypot(direction[:, 0], direction[:, 1]) * np.abs(direction[:, 2]) / acceleration[:2].min()
    most, corners, most_there = timing._CORNER_SHARE, np.zeros(len(length)), np.ones(len(length))
    corners[1:-1] = np.maximum(turn / CONTROL_STEP, turn / mean)
    most_there[1:-1] = np.minimum((most * CONTROL_STEP / turn) ** 2, most * mean / turn)
    beside = np.minimum(most / np.maximum(swing, timing._TINY), slower)
    squared = np.minimum.reduce([most_there, np.ones(len(length)), np.append(beside, 1.0), np.append(1.0, beside)])
    squared[0] = squared[-1] = 0.0
    taken, gain = np.maximum(np.maximum(corners[:-1], corners[1:]), swing), 2 * steps / share(direction) * slower
    for i in range(len(steps)):
        squared[i + 1] = min(squared[i + 1], squared[i] + (1.0 - min(taken[i] * squared[i], most)) * gain[i])
    for i in reversed(range(len(steps))):
        squared[i] = min(squared[i], squared[i + 1] + (1.0 - min(taken[i] * squared[i + 1], most)) * gain[i])
    return np.sqrt(squared)


def twin_samples(clock: Any, speed: Any, length: Any, points: Any) -> np.ndarray:
    """NumPy twin of the kernel that samples a path."""
    times = CONTROL_STEP * np.arange(int(np.ceil(clock[-1] / CONTROL_STEP - 1e-9)) + 1)
    piece = np.clip(np.searchsorted(clock, times, side="right") - 1, 0, len(clock) - 2)
    since, span = np.minimum(times, clock[-1]) - clock[piece], (clock[1:] - clock[:-1])[piece]
    way = speed[piece] * since + 0.5 * np.diff(speed)[piece] / span * since**2
    return interpolate(np.clip(length[piece] + way, length[piece], length[piece + 1]), length, points)


def test_compiled_timing_is_that_of_numpy_bit_for_bit() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        length, points = timing._grid(random_polygon(rng), VELOCITY)
        is_slow = rng.random(len(points) - 1) < 0.2
        speed = timing._speeds(length, points, ACCELERATION, is_slow)
        assert np.array_equal(speed, twin_speeds(length, points, ACCELERATION, is_slow))
        clock = np.concatenate([[0.0], np.cumsum(2 * np.diff(length) / (speed[:-1] + speed[1:]))])
        samples = timing._sample(clock, speed, length, points)
        assert np.array_equal(samples, twin_samples(clock, speed, length, points))
