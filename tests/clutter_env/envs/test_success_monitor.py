"""What the monitor counts: paths of objects out of hand, falls, clearances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clutter_env.envs.success import CHORD, RELEASE_STEPS, SuccessMonitor, checked_memory
from clutter_env.errors import StateError
from clutter_env.simulation.world import Measurements


class Table:
    """Objects that a test moves by hand, watched by a monitor without a target."""

    def __init__(self, count: int = 3) -> None:
        self.poses = np.tile((0.0, 0.0, 0.8, 1.0, 0.0, 0.0, 0.0), (count, 1))
        self.poses[:, 1] = 0.2 * np.arange(count)
        self.fallen = np.zeros(count, bool)
        self.held = -1
        self.monitor = SuccessMonitor(None, self.measurements(), -1)  # type: ignore[arg-type]  # read for a target only

    def measurements(self) -> Measurements:
        return Measurements(self.poses.copy(), self.fallen.copy(), self.fallen & False, (self.held,), self.held >= 0)

    def step(self, slot: int = 0, by: tuple[float, float, float] = (0.0, 0.0, 0.0), count: int = 1) -> None:
        for _ in range(count):
            self.poses[slot, :3] += by
            self.monitor.update(self.measurements())

    def counts(self) -> tuple[int, int, int]:
        return self.monitor.num_fallen, self.monitor.num_disturbed, self.monitor.num_cleared


@pytest.mark.parametrize("steps", [1, 7, 60, 6000])
def test_a_path_of_five_centimetres_disturbs_however_slow(steps: int) -> None:
    table = Table()
    table.step(0, (0.0499 / steps, 0, 0), steps)
    assert table.monitor.is_clean
    table.step(0, (0.0002, 0, 0))
    assert table.counts() == (0, 1, 0), "the limit is exact to a fraction of a chord"
    assert not table.monitor.is_clean


def test_jitter_never_adds_up() -> None:
    table, rng = Table(), np.random.default_rng(0)
    rest = table.poses[0, :3].copy()
    for _ in range(20_000):
        noise = rng.normal(size=3)
        table.poses[0, :3] = rest + 0.45 * CHORD * noise / np.linalg.norm(noise)
        table.step()
    assert table.monitor.is_clean


def test_pushing_forth_and_back_accumulates() -> None:
    table = Table()
    for sign in (1, -1, 1):
        table.step(0, (sign * 0.002, 0, 0), 12)
    assert table.counts() == (0, 1, 0)


def test_every_object_has_a_path_of_its_own() -> None:
    table = Table()
    for slot in range(3):
        table.step(slot, (0.004, 0, 0), 10)
    assert table.monitor.is_clean
    for slot in (0, 2):
        table.step(slot, (0.004, 0, 0), 4)
    assert table.counts() == (0, 2, 0)


def test_carrying_and_putting_down_is_clearing() -> None:
    table = Table()
    table.held = 1
    table.step(1, (0.01, 0, 0.01), 30)
    assert table.counts() == (0, 0, 0), "still in hand"
    table.held = -1
    table.step(1, count=RELEASE_STEPS)
    assert table.counts() == (0, 0, 1)
    assert table.monitor.is_clean
    table.step(1, (0.02, 0, 0), 3)
    assert table.counts() == (0, 1, 1), "pushed after it was put down"


def test_a_step_without_contact_is_no_release() -> None:
    table = Table()
    for step in range(30):
        table.held = -1 if step % 3 == 2 else 1
        table.step(1, (0.02, 0, 0))
    assert table.counts() == (0, 0, 0)


@pytest.mark.parametrize("lost", [(0.06, 0, 0), (0, 0, -0.3)], ids=["torn out", "dropped"])
def test_an_object_that_the_gripper_loses_is_disturbed(lost: tuple[float, float, float]) -> None:
    table = Table()
    table.held = 1
    table.step(1, (0.01, 0, 0), 3)
    table.held = -1
    table.step(1, lost)
    table.step(1)
    assert table.counts() == (0, 1, 0)


def test_a_memory_of_other_objects_is_refused() -> None:
    memory = Table(3).monitor.memory()
    checked_memory(memory, 3, 1)
    for entry in ({"in_hand": 3}, {"paths": [0.0] * 2}, {"grasped_at": [0.0, 0.0]}, {"other_hands": []}):
        with pytest.raises(StateError, match="judge"):
            checked_memory({**memory, **entry}, 3, 1)
    with pytest.raises(StateError, match="other_hands"):
        checked_memory(memory, 3, 2)


def test_a_fall_counts_even_if_the_object_is_set_upright_again() -> None:
    table = Table()
    table.fallen[2] = True
    table.step()
    assert table.monitor.newly_disturbed == 1
    table.fallen[2] = False
    table.step()
    assert (table.monitor.num_fallen, table.monitor.newly_disturbed) == (1, 0)


def test_an_object_that_falls_and_moves_is_newly_disturbed_once() -> None:
    table = Table()
    total = 0
    for _ in range(10):
        table.fallen[2] = True
        table.step(2, (0.01, 0, 0))
        total += table.monitor.newly_disturbed
    assert total == 1
    assert table.counts() == (1, 1, 0)


def test_measurements_that_are_given_again_count_as_new_ones() -> None:
    """The world gives the same object again while nothing moves; the monitor must not lose a step by it."""
    rng = np.random.default_rng(0)
    table = Table()
    other = SuccessMonitor(None, table.measurements(), -1)  # type: ignore[arg-type]  # read for a target only
    for _ in range(400):
        slot = int(rng.integers(3))
        table.poses[slot, 0] += rng.choice((0.0, 0.004, 0.03))
        table.held = int(rng.choice((-1, -1, slot)))
        table.fallen[slot] |= rng.random() < 0.003
        given = table.measurements()
        for _ in range(rng.integers(1, 5)):
            table.monitor.update(given)
            other.update(replace(given))
            assert table.monitor.memory() == other.memory()
            assert table.monitor.newly_disturbed == other.newly_disturbed
    assert all(table.counts()), "the test has seen falls, disturbances and clearances"
