"""The lower bound on clearances against brute force, and laws it must obey."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from planners.cause import Cause
from planners.clearing.lower_bound import (
    FloorLimits,
    FloorOptionsError,
    clearance_floor,
    minimum_clearances,
    self_clearable_sets,
)

STATIC = 1 << 63


def random_options(rng: np.random.Generator, count: int) -> dict[int, list[int]]:
    """Sparse random blockers, some options against static obstacles, some objects without options."""
    density = rng.uniform(0.1, 0.5)
    options = {}
    for index in range(count):
        masks = [
            sum(1 << int(i) for i in np.flatnonzero(rng.random(count) < density)) for _ in range(rng.integers(0, 4))
        ]
        options[index] = [mask | STATIC if rng.random() < 0.1 else mask for mask in masks]
    return options


def is_removable(options: dict[int, list[int]], objects: Sequence[int], target: int) -> bool:
    """Brute force: take away whatever can be taken; is nothing left, with the target last?"""
    removed, remaining = 0, set(objects)
    while remaining:
        free = {i for i in remaining if any(m & ~(1 << i) & ~removed == 0 for m in options[i])}
        if not free:
            return False
        removed |= sum(1 << i for i in free)
        remaining -= free
    return any(m & ~(1 << target) & ~removed == 0 for m in options[target])


def brute_force(options: dict[int, list[int]], target: int) -> list[frozenset[int]]:
    """All smallest sets of clearances."""
    others = [i for i in options if i != target]
    for size in range(len(others) + 1):
        found = [frozenset(s) for s in combinations(others, size) if is_removable(options, s, target)]
        if found:
            return found
    return []


def objects_of(mask: int) -> frozenset[int]:
    return frozenset(i for i in range(64) if mask >> i & 1)


@pytest.mark.parametrize("seed", range(4))
def test_lower_bound_and_all_smallest_sets_match_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    feasible = 0
    for _ in range(100):
        count = int(rng.integers(2, 9))
        options = random_options(rng, count)
        target = int(rng.integers(count))
        expected = brute_force(options, target)
        results = list(self_clearable_sets(options, target))
        if not expected:
            assert results[0].count is None
            assert results[0].proved
            assert results[0].cause in (Cause.UNREACHABLE, Cause.NO_SELF_CLEARABLE_SET)
            continue
        feasible += 1
        assert all(r.proved and r.count == r.lower_bound == len(expected[0]) for r in results)
        assert len(results) == len(expected)
        assert {objects_of(r.mask) for r in results} == set(expected)
    assert feasible > 30


def test_the_order_takes_each_object_through_its_first_option_that_is_free() -> None:
    rng = np.random.default_rng(5)
    for _ in range(60):
        options = random_options(rng, 9)
        result = minimum_clearances(options, 0)
        if result.count is None:
            continue
        assert frozenset(result.objects) == objects_of(result.mask)
        removed = 0
        for step in result.order:
            masks = [mask & ~(1 << step.object) for mask in options[step.object]]
            assert step.option == next(j for j, mask in enumerate(masks) if mask & ~removed == 0)
            removed |= 1 << step.object
        assert result.order[-1].object == 0
        assert removed == result.mask | 1


def test_adding_an_option_never_raises_the_lower_bound() -> None:
    rng = np.random.default_rng(6)
    for _ in range(60):
        options = random_options(rng, 10)
        before = minimum_clearances(options, 0).count
        index = int(rng.integers(10))
        extra = {**options, index: [*options[index], int(rng.integers(1, 1 << 10))]}
        after = minimum_clearances(extra, 0).count
        if before is not None:
            assert after is not None
            assert after <= before


def test_slack_yields_larger_minimal_sets_in_order_of_size() -> None:
    options = {0: [0b0010, 0b1100], 1: [0], 2: [0], 3: [0]}
    assert [objects_of(r.mask) for r in self_clearable_sets(options, 0)] == [{1}]
    assert [objects_of(r.mask) for r in self_clearable_sets(options, 0, slack=1)] == [{1}, {2, 3}]
    rng = np.random.default_rng(7)
    for _ in range(40):
        options = random_options(rng, 8)
        results = [r for r in self_clearable_sets(options, 0, slack=2) if r.count is not None]
        masks = [r.mask for r in results]
        assert len(masks) == len(set(masks))
        assert [r.count for r in results] == sorted(r.count for r in results if r.count is not None)
        every = [set(s) for n in range(8) for s in combinations(range(1, 8), n) if is_removable(options, s, 0)]
        minimal = [s for s in every if not any(other < s for other in every)]
        fewest = min(map(len, minimal), default=0)
        assert sorted(map(sorted, map(objects_of, masks))) == sorted(sorted(s) for s in minimal if len(s) <= fewest + 2)


def test_options_are_asked_for_once_and_only_where_they_matter() -> None:
    asked: list[int] = []

    def options(index: int) -> list[int]:
        asked.append(index)
        return {0: [0b10, 0b11111100], 1: [0]}.get(index, [0])

    assert minimum_clearances(options, 0).objects == (1,)
    assert sorted(asked) == [0, 1]


def test_causes() -> None:
    assert minimum_clearances({0: [], 1: [0]}, 0).cause == Cause.UNREACHABLE
    assert minimum_clearances({0: [STATIC | 2], 1: [0]}, 0).cause == Cause.UNREACHABLE
    assert minimum_clearances({0: [0b10], 1: [0b100], 2: [0b10]}, 0).cause == Cause.NO_SELF_CLEARABLE_SET
    assert minimum_clearances({0: [0b10], 1: [0b01]}, 0).cause == Cause.NO_SELF_CLEARABLE_SET
    assert minimum_clearances({0: [0b01]}, 0).count == 0, "an object never blocks itself"


def random_clutter(rng: np.random.Generator, count: int) -> list[list[int]]:
    """Options of discs on a 0.8 × 0.6 m table for a hand 0.13 m wide that comes from the front at 31 angles."""
    centres = rng.uniform((0.04, 0.04), (0.76, 0.56), (count, 2))
    options = []
    for index, centre in enumerate(centres):
        away = centres - centre
        masks = []
        for angle in np.linspace(-1.3, 1.3, 31):
            along = away @ (np.sin(angle), -np.cos(angle))
            across = np.abs(away @ (np.cos(angle), np.sin(angle)))
            hit = (along > -0.02) & (across < 0.095) & (along < 0.30)
            masks.append(sum(1 << int(i) for i in np.flatnonzero(hit) if i != index))
        options.append(masks)
    return options


def test_dense_clutter_of_60_is_proved_within_the_default_limits() -> None:
    for seed in range(8):
        options = random_clutter(np.random.default_rng(seed), 60)
        assert minimum_clearances(options.__getitem__, 0).proved


def test_limits_give_honest_bounds() -> None:
    rng = np.random.default_rng(3)
    unproved = 0
    for _ in range(8):
        options = random_clutter(rng, 50)
        exact = minimum_clearances(options.__getitem__, 0)
        result = minimum_clearances(options.__getitem__, 0, FloorLimits(expansions=1))
        if exact.count is None:
            assert result.count is None
            continue
        assert result.count is not None
        assert result.lower_bound <= exact.count <= result.count
        assert is_removable(dict(enumerate(options)), result.objects, 0)
        unproved += not result.proved
    assert unproved


def test_misuse_is_refused() -> None:
    with pytest.raises(FloorOptionsError, match="object 1"):
        minimum_clearances({0: [0b10]}, 0)
    with pytest.raises(FloorOptionsError, match="negative"):
        minimum_clearances({0: [-1]}, 0)
    with pytest.raises(FloorOptionsError, match="valid"):
        minimum_clearances({}, 60)


def test_the_lower_bound_of_a_scene_speaks_in_names() -> None:
    blockers = {"cup": [0b110], "jar": [0b100], "can": [0]}
    names = tuple(blockers)
    scene = SimpleNamespace(names=names, index=names.index, held_names=())
    floor = clearance_floor(scene, "cup", blockers.__getitem__)
    assert (floor.count, floor.objects, floor.options, floor.proved) == (2, ("can", "jar"), (0, 0, 0), True)
    holding = SimpleNamespace(names=names, index=names.index, held_names=("cup",))
    assert clearance_floor(holding, "cup", blockers.__getitem__).count == 0
