"""What the monitor counts: paths of objects that are not carried, falls, clearances, pressing."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from clutter_env.envs.success import CHORD, RELEASE_STEPS, SuccessMonitor, checked_memory
from clutter_env.errors import StateError
from clutter_env.simulation.pressing import SUSTAINED_FORCE, Pressing
from clutter_env.simulation.world import Grip, Measurements

FREE, DRAGGED, CARRIED = range(3)
"""An object may be out of hand, held while it touches something, or held and touch nothing else."""


class Table:
    """Objects that a test moves by hand, watched by a monitor without a target."""

    def __init__(self, count: int = 3) -> None:
        self.poses = np.tile((0.0, 0.0, 0.8, 1.0, 0.0, 0.0, 0.0), (count, 1))
        self.poses[:, 1] = 0.2 * np.arange(count)
        self.fallen = np.zeros(count, bool)
        self.held, self.is_carried = -1, False
        self.moved = frozenset[int]()
        # Of a world, the monitor reads no more without a target.
        self.world = SimpleNamespace(on_furniture=Pressing(), on_itself=Pressing(), drawer_shifts=[0.0])
        self.monitor = self.another_monitor()

    def another_monitor(self) -> SuccessMonitor:
        return SuccessMonitor(self.world, self.measurements(), -1)  # type: ignore[arg-type]  # see above

    def measurements(self) -> Measurements:
        grip = Grip((self.held,), (self.is_carried,), self.held >= 0)
        return Measurements(self.poses.copy(), self.fallen.copy(), self.fallen & False, grip, self.moved)

    def hand(self, state: int, slot: int = 0) -> None:
        """From now on the object in this slot is free, dragged or carried."""
        self.held, self.is_carried = (-1 if state == FREE else slot), state == CARRIED

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
    assert table.counts() == (0, 0, 0)
    for slot in (0, 2):
        table.step(slot, (0.004, 0, 0), 4)
    assert table.counts() == (0, 2, 0)


@pytest.mark.parametrize("seed", range(20))
def test_all_travel_is_booked_but_that_of_steps_that_begin_and_end_carried(seed: int) -> None:
    """Travel across touches, in the grip along the table, of an open chord before a lift, and while brushing."""
    table, rng = Table(), np.random.default_rng(seed)
    booked, was_carried = 0.0, False
    for _ in range(40):
        table.hand(rng.choice((FREE, DRAGGED, CARRIED)))
        for _ in range(rng.integers(1, 4)):
            length = rng.choice((0.0, 2e-5, 4e-4))
            table.step(0, (length, 0, 0))
            booked += 0.0 if was_carried and table.is_carried else length
            was_carried = table.is_carried
    memory = table.monitor.memory()
    open_chord = float(np.linalg.norm(table.poses[0, :3] - memory["chord_starts"][0]))
    assert memory["paths"][0] + open_chord == pytest.approx(booked, abs=1e-12)
    assert open_chord <= CHORD


def test_nudges_of_less_than_a_chord_add_up_across_lifts_and_touches() -> None:
    table = Table()
    for state in (CARRIED, DRAGGED) * 7:
        table.hand(FREE)
        table.step(0, (0.8 * CHORD, 0, 0))
        table.hand(state)
        table.step()
    assert table.counts() == (0, 1, 0)


def test_dragging_in_the_grip_is_no_clearing() -> None:
    table = Table()
    table.hand(DRAGGED)
    table.step(0, (0.01, 0, 0), 6)
    table.hand(FREE)
    table.step(count=RELEASE_STEPS)
    assert table.counts() == (0, 1, 0)


def test_carrying_and_putting_down_is_clearing() -> None:
    table = Table()
    table.hand(CARRIED, 1)
    table.step(1)
    table.step(1, (0.01, 0, 0.01), 30)
    assert table.counts() == (0, 0, 0), "still in hand"
    table.hand(FREE)
    table.step(1, count=RELEASE_STEPS)
    assert table.counts() == (0, 0, 1)
    assert table.monitor.is_clean
    table.step(1, (0.02, 0, 0), 3)
    assert table.counts() == (0, 1, 0), "pushed after it was put down"


def test_an_object_is_put_down_once_however_often_contact_is_missing() -> None:
    table = Table()
    table.hand(CARRIED, 1)
    table.step(1)
    for step in range(30):
        table.hand(FREE if step % 3 == 2 else CARRIED, 1)
        table.step(1, (0.02 if step % 3 == 1 else 0.0, 0, 0))
    assert table.counts() == (0, 0, 0)


@pytest.mark.parametrize("lost", [(0.06, 0, 0), (0, 0, -0.3)], ids=["torn out", "dropped"])
def test_an_object_that_the_gripper_loses_is_disturbed(lost: tuple[float, float, float]) -> None:
    table = Table()
    table.hand(CARRIED, 1)
    table.step(1)
    table.step(1, (0.03, 0, 0), 3)
    table.hand(FREE)
    table.step(1, lost)
    table.step(1)
    assert table.counts() == (0, 1, 0)


@pytest.mark.parametrize("where", ["on_furniture", "on_itself"])
def test_pressing_hard_is_not_clean(where: str) -> None:
    table = Table()
    pressing = getattr(table.world, where)
    pressing.add([SUSTAINED_FORCE] * 200)
    assert table.monitor.is_clean
    pressing.add([SUSTAINED_FORCE + 0.1] * 50)
    assert not table.monitor.is_clean


def test_a_row_of_objects_shoved_a_little_each_is_not_clean() -> None:
    table = Table()
    for slot in range(3):
        table.step(slot, (0.004, 0, 0), 10)
    assert table.counts() == (0, 0, 0)
    assert table.monitor.total_path == pytest.approx(0.12, abs=0.01)
    assert not table.monitor.is_clean
    table.monitor.named = {0, 1, 2}
    assert table.monitor.is_clean, "the goal is about these objects"


def test_shaking_in_the_grip_adds_up() -> None:
    table = Table()
    for sign in (1, -1) * 30:
        table.step(0, (sign * 0.002, 0, 0))
    assert table.monitor.is_clean, "nothing touches it: it quivers"
    table.moved = frozenset({0})
    for sign in (1, -1) * 30:
        table.step(0, (sign * 0.002, 0, 0))
    assert table.counts() == (0, 1, 0)


def test_a_memory_of_other_objects_is_refused() -> None:
    memory = Table(3).monitor.memory()
    checked_memory(memory, 3, 1)
    for entry in ({"hands": [[3.0] * 8]}, {"hands": [[0.0] * 7]}, {"paths": [0.0] * 2}, {"more": 0}):
        with pytest.raises(StateError, match="monitor"):
            checked_memory({**memory, **entry}, 3, 1)
    with pytest.raises(StateError, match="hands"):
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
    other, cleared, slot = table.another_monitor(), 0, 0
    for _ in range(400):
        if rng.random() < 0.5:
            slot = int(rng.integers(3))
            table.hand(rng.choice((FREE, DRAGGED, CARRIED)), slot)
        table.poses[slot, 0] += rng.choice((0.0, 0.03 if table.is_carried else 0.0005))
        table.fallen[slot] |= rng.random() < 0.003
        given = table.measurements()
        for _ in range(rng.integers(1, 5)):
            table.monitor.update(given)
            other.update(replace(given))
            assert table.monitor.memory() == other.memory()
            assert table.monitor.newly_disturbed == other.newly_disturbed
        cleared = max(cleared, table.monitor.num_cleared)
    assert min(*table.counts()[:2], cleared), "the test has seen falls, disturbances and clearances"


def test_what_rides_in_a_drawer_travels_as_far_as_it_slides_in_it() -> None:
    table = Table()
    table.world.are_in_drawer = lambda *_: np.arange(len(table.poses)) == 0
    for _ in range(20):
        table.world.drawer_shifts = [table.world.drawer_shifts[0] - 0.01]
        table.poses[:2, 0] -= 0.01
        table.step()
    assert table.monitor.num_disturbed == 1, "the one that stands in its way"
    for _ in range(20):  # with a drawer that leaves it behind
        table.world.drawer_shifts = [table.world.drawer_shifts[0] + 0.01]
        table.step()
    assert table.monitor.num_disturbed == 2
