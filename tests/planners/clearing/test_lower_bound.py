"""The lower bound on clearances against brute force, and laws it must obey."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from planners.cause import Cause
from planners.clearing.lower_bound import ClearanceFloor, self_clearable_sets

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


def sets(options: Callable[[int], list[int]], count: int, target: int = 0, **how: Any) -> Iterator[ClearanceFloor]:
    return self_clearable_sets(lambda name: options(int(name)), str(target), [str(i) for i in range(count)], **how)


def smallest(options: dict[int, list[int]], **how: Any) -> ClearanceFloor:
    return next(sets(options.__getitem__, len(options), **how))


def objects_of(result: ClearanceFloor) -> frozenset[int]:
    return frozenset(map(int, result.objects))


@pytest.mark.parametrize("seed", range(4))
def test_lower_bound_and_all_smallest_sets_match_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    feasible = 0
    for _ in range(100):
        count = int(rng.integers(2, 9))
        options = random_options(rng, count)
        target = int(rng.integers(count))
        expected = brute_force(options, target)
        results = list(sets(options.__getitem__, count, target))
        if not expected:
            assert results[0].is_infeasible
            assert results[0].cause in (Cause.UNREACHABLE, Cause.NO_SELF_CLEARABLE_SET)
            continue
        feasible += 1
        assert all(r.proved and r.count == r.lower_bound == len(expected[0]) for r in results)
        assert len(results) == len(expected)
        assert set(map(objects_of, results)) == set(expected)
    assert feasible > 30


def test_the_order_takes_each_object_through_its_first_option_that_is_free() -> None:
    rng = np.random.default_rng(5)
    for _ in range(60):
        options = random_options(rng, 9)
        result = smallest(options)
        removed = 0
        for index, option in zip((*map(int, result.objects), 0), result.options, strict=False):
            masks = [mask & ~(1 << index) for mask in options[index]]
            assert option == next(j for j, mask in enumerate(masks) if mask & ~removed == 0)
            removed |= 1 << index
        assert result.count is None or len(result.options) == result.count + 1


def test_adding_an_option_never_raises_the_lower_bound() -> None:
    rng = np.random.default_rng(6)
    for _ in range(60):
        options = random_options(rng, 10)
        before = smallest(options).count
        index = int(rng.integers(10))
        after = smallest({**options, index: [*options[index], int(rng.integers(1, 1 << 10))]}).count
        assert before is None or (after is not None and after <= before)


def test_sets_that_are_not_fewer_than_known_ones_count_as_none() -> None:
    rng = np.random.default_rng(8)
    for _ in range(60):
        options = random_options(rng, 9)
        fewest = smallest(options)
        for most in range(5):
            result = smallest(options, fewer_than=most)
            if fewest.count is None or fewest.count < most:
                assert (result.count, result.proved) == (fewest.count, True)
            else:
                assert result.is_infeasible
                assert most <= result.lower_bound <= fewest.count


def test_masks_that_each_option_hits_leave_options_unasked_and_the_answer_the_same() -> None:
    rng, asked, without = np.random.default_rng(9), list[int](), list[int]()
    for _ in range(100):
        options = random_options(rng, 10)
        # Each option hits one of these: a part of its own mask.
        parts = {index: [mask & int(rng.integers(1 << 62)) for mask in masks] for index, masks in options.items()}
        before = len(asked)
        found = next(sets(noted(options, asked), 10, at_least=noted({str(k): v for k, v in parts.items()}, [])))
        assert len(set(asked[before:])) == len(asked) - before
        every = next(sets(noted(options, without), 10))
        assert (found.count, found.proved) == (every.count, every.proved)
    assert len(asked) < len(without)


def noted(options: Mapping[Any, list[int]], asked: list[Any]) -> Callable[[Any], list[int]]:
    """The options of an object, whose name is added to those asked for."""

    def take(name: Any) -> list[int]:
        asked.append(name)
        return options[name]

    return take


def test_slack_yields_larger_minimal_sets_in_order_of_size() -> None:
    rng = np.random.default_rng(7)
    for _ in range(40):
        options = random_options(rng, 8)
        results = [r for r in sets(options.__getitem__, 8, slack=2) if r.count is not None]
        assert [r.count for r in results] == sorted(r.count for r in results if r.count is not None)
        every = [set(s) for n in range(8) for s in combinations(range(1, 8), n) if is_removable(options, s, 0)]
        minimal = [s for s in every if not any(other < s for other in every)]
        fewest = min(map(len, minimal), default=0)
        assert sorted(map(sorted, map(objects_of, results))) == sorted(
            sorted(s) for s in minimal if len(s) <= fewest + 2
        )


def test_options_are_asked_for_once_and_only_where_they_matter() -> None:
    asked: list[int] = []

    def options(index: int) -> list[int]:
        asked.append(index)
        return {0: [0b10, 0b11111100], 1: [0]}.get(index, [0])

    assert objects_of(next(sets(options, 8))) == {1}
    assert sorted(asked) == [0, 1]


def test_causes() -> None:
    assert smallest({0: [], 1: [0]}).cause == Cause.UNREACHABLE
    assert smallest({0: [STATIC | 2], 1: [0]}).cause == Cause.UNREACHABLE
    assert smallest({0: [0b10], 1: [0b100], 2: [0b10]}).cause == Cause.NO_SELF_CLEARABLE_SET
    assert smallest({0: [0b10], 1: [0b01]}).cause == Cause.NO_SELF_CLEARABLE_SET
    assert smallest({0: [0b01]}).count == 0, "an object never blocks itself"


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


def test_dense_clutter_is_proved_within_the_default_limits_and_small_limits_give_honest_bounds() -> None:
    unproved = 0
    for seed in range(8):
        options = dict(enumerate(random_clutter(np.random.default_rng(seed), 60)))
        exact, result = smallest(options), smallest(options, expansions=1)
        assert exact.proved
        assert (exact.count is None) == (result.count is None)
        if exact.count is not None and result.count is not None:
            assert result.lower_bound <= exact.count <= result.count
            assert is_removable(options, sorted(objects_of(result)), 0)
            unproved += not result.proved
    assert unproved


def test_sets_are_named_in_an_order_of_removal() -> None:
    blockers = {"cup": [0b110], "jar": [0b100], "can": [0]}
    floor = next(self_clearable_sets(blockers.__getitem__, "cup", tuple(blockers)))
    assert (floor.count, floor.objects, floor.options, floor.proved) == (2, ("can", "jar"), (0, 0, 0), True)
