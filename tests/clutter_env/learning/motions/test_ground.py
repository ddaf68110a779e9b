"""Where the base drives: round the ground that no demonstration has entered, and with the arm tucked in."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("torch")

import assets
import clutter_env  # noqa: F401  registers the environments
from clutter_env.learning.contacts.reading import Reading, planar_pose, read
from clutter_env.learning.keyframes.ground import Ground, closed_ground
from clutter_env.learning.keyframes.motions import Motion
from clutter_env.learning.keyframes.mover import KeyframeMover
from planners.contact import Contact

Array = NDArray[np.float64]
FRONT = Ground(np.array((-0.65, -1.4)), np.array((np.inf, 1.4)))
"""Table and counters with a wall behind them."""
ISLAND = Ground(np.array((-0.7, -0.9)), np.array((0.7, 0.9)))


def depth(ground: Ground, start: Array, way: Array) -> float:
    """[m] by which the straight lines of a way lie inside, measured at many points."""
    stops = np.vstack((start[:2], way[:, :2]))
    points = np.concatenate([np.linspace(one, other, 200) for one, other in pairwise(stops)])
    return float(np.minimum(points - ground.low, ground.high - points).min(axis=1).max())


@pytest.mark.parametrize(
    ("ground", "start", "goal", "stops"),
    [
        (FRONT, (-1.2, 0.3, 0.0), (-0.66, 1.0, -0.8), 1),
        (FRONT, (-1.2, 0.3, 0.0), (0.2, 1.41, -1.57), 2),
        (FRONT, (0.2, -1.41, 1.57), (-0.66, 0.3, 0.0), 2),
        (FRONT, (0.2, -1.41, 1.57), (0.1, 1.41, -1.57), 3),
        (ISLAND, (-0.8, 0.3, 0.0), (-0.7, -0.8, 0.4), 1),
        (ISLAND, (-0.8, 0.3, 0.0), (0.0, 1.0, -1.57), 2),
        (ISLAND, (-0.8, 0.3, 0.0), (0.8, 0.2, 3.1), 3),
        (ISLAND, (0.1, -0.95, 1.5), (0.8, 0.2, 3.1), 2),
    ],
)
def test_the_base_goes_round_closed_ground_and_straight_where_it_is_open(
    ground: Ground, start: tuple[float, ...], goal: tuple[float, ...], stops: int
) -> None:
    here, there = np.array(start), np.array(goal)
    way = ground.way(here, there)
    assert len(way) == stops
    assert depth(ground, here, way) < 1e-5
    np.testing.assert_allclose(way[-1], there, atol=1e-9)


def test_a_base_that_is_wanted_on_closed_ground_is_driven_to() -> None:
    start, goal = np.array((-1.2, 0.3, 0.0)), np.array((0.0, 1.2, -1.57))
    way = FRONT.way(start, goal)
    np.testing.assert_allclose(way[-1], goal)
    assert depth(Ground(FRONT.low, np.array((np.inf, 1.2))), start, way) < 1e-5
    np.testing.assert_array_equal(FRONT.high, (np.inf, 1.4))


def test_without_closed_ground_all_drives_are_straight() -> None:
    assert len(closed_ground([]).way(np.array((-1.0, 0.0, 0.0)), np.array((1.0, 0.0, 0.0)))) == 1


def drive(*stops: tuple[float, float]) -> Motion:
    """A demonstrated drive over these places, a step every 5 cm."""
    legs = pairwise(stops)
    xy = np.concatenate([np.linspace(one, other, 40) for one, other in legs])
    count, none = len(xy), np.zeros(0)
    reading = Reading(np.column_stack((xy, np.zeros(count))), none, none, none, none, none)
    contact = Contact("pick", "", np.zeros(3), np.eye(4))
    return Motion(contact, 0, reading, np.zeros((count - 1, 12)), ("drive",) * (count - 1), np.zeros((count - 1, 12)))


def test_closed_ground_is_what_demonstrations_drive_round() -> None:
    front = [drive((-0.65, -0.5), (-0.65, 0.5)), drive((-0.7, 0.0), (-0.7, 1.4), (0.3, 1.4))]
    front.append(drive((-0.8, 0.2), (-0.8, -1.4), (0.2, -1.4)))
    found = closed_ground(front)
    np.testing.assert_allclose((*found.low, found.high[1]), (-0.65, -1.4, 1.4), atol=0.021)
    assert found.high[0] == np.inf

    island = [drive((-0.7, -0.9), (0.7, -0.9), (0.7, 0.9), (-0.7, 0.9), (-0.7, -0.9))]
    found = closed_ground(island)
    np.testing.assert_allclose((found.low, found.high), (ISLAND.low, ISLAND.high), atol=0.021)
    assert np.isinf(closed_ground([drive((-0.65, -0.3), (-0.65, 0.4))]).high).all()


@pytest.fixture(scope="module")
def env() -> gym.Env[Any, Any]:
    return gym.make("clutter_env/Retrieve-o1-v0")


def driven(env: gym.Env[Any, Any], observation: Any, base: tuple[float, ...]) -> tuple[KeyframeMover, Reading]:
    """The mover of the package at the end of its drive to a contact straight ahead of a base, and where it is then."""
    mover = KeyframeMover.load(assets.path("policies/keyframes-side.npz"))
    mover.reset(env, {})
    ahead = np.eye(4)
    ahead[:3, 3] = 0.75, 0.0, 0.85
    mover.start(Contact("pick", "object_00", np.array(base), planar_pose(np.array(base)) @ ahead), observation)
    while not mover.is_done and mover.phase == "drive":
        observation, *_ = env.step(mover.act(observation))
    return mover, read(observation)


@pytest.mark.parametrize("base", [(0.2, 1.41, -1.57), (0.2, -1.41, 1.57)])
def test_a_drive_to_the_side_of_a_counter_goes_round_its_corner(
    env: gym.Env[Any, Any], base: tuple[float, ...]
) -> None:
    observation, _ = env.reset(seed=4)
    mover, reading = driven(env, observation, base)
    assert not mover.has_missed
    np.testing.assert_allclose(reading.base[:2], base[:2], atol=0.03)


def test_the_base_drives_once_an_arm_that_was_out_is_tucked_in(env: gym.Env[Any, Any]) -> None:
    observation, _ = env.reset(seed=5)
    arm_out = np.zeros(12)
    arm_out[4] = 1.0
    for _ in range(20):
        observation, *_ = env.step(arm_out)
    mover, reading = driven(env, observation, (-0.8, 0.4, 0.0))
    assert not mover.has_missed
    np.testing.assert_allclose(reading.base[:2], (-0.8, 0.4), atol=0.03)
