"""The fewest picks beside an exhaustive search, on tables of what is in the way of what."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from planners.clearing.goal_bound import LowerBound, PickTable
from planners.placing.blockers import PutDownMasks

STANDS, ASIDE, END, HELD, TAKEN = range(5)
"""Where an object is. TAKEN: in a hand, and nothing else has happened since it was taken from where it stood."""


class Model(NamedTuple):
    """A table, and the same for the exhaustive search."""

    table: PickTable
    takes: list[list[int]]
    on: dict[int, int]


def exhaustive(model: Model) -> int | None:
    """The fewest picks of any sequence of moves, by breadth-first search; None if there is none."""
    table, n = model.table, len(model.table.names)
    to_move = {int(name) for name in table.to_move}
    hold = {int(name) for name in table.hold}
    ends = {int(name) for name in table.waits} - hold

    def is_done(state: tuple[int, ...]) -> bool:
        for one in range(n):
            if one in hold and state[one] != HELD:
                return False
            if one in to_move and one not in hold and (state[one] == STANDS or (one in ends and state[one] != END)):
                return False
            if one not in to_move and one in ends and state[one] == ASIDE:
                return False
        return True

    def is_free(state: tuple[int, ...], masks: list[int]) -> bool:
        standing = sum(1 << one for one in range(n) if state[one] == STANDS)
        return any(not mask & standing for mask in masks)

    def is_final(state: tuple[int, ...], one: int) -> bool:
        """Whether an object has made its last move, or need make none."""
        if one in ends:
            return state[one] == END or (state[one] == STANDS and one not in to_move)
        return state[one] != STANDS or one not in to_move

    def may_take(state: tuple[int, ...], one: int) -> bool:
        if state[one] == STANDS and not is_free(state, model.takes[one]):
            return False
        if any(state[above] == END and below == one for above, below in model.on.items()):
            return False
        for first, second in table.order:
            # The last move of the first comes before the first one of the second.
            if int(second) == one and not is_final(state, int(first)):
                return False
            if int(first) == one and state[int(second)] != STANDS:
                return False
        return True

    def then(state: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        if HELD in state:
            return
        for one in range(n):
            if not may_take(state, one):
                continue
            if one in hold:
                yield (*state[:one], HELD, *state[one + 1 :])
            if state[one] == STANDS:
                yield (*state[:one], ASIDE, *state[one + 1 :])
            if one in ends and state[one] != END and may_put(state, one):
                yield (*state[:one], END, *state[one + 1 :])

    def may_put(state: tuple[int, ...], one: int) -> bool:
        in_hand = (*state[:one], HELD, *state[one + 1 :])
        standing = sum(1 << other for other in range(n) if in_hand[other] == STANDS)
        if table.waits[str(one)] & standing or (table.waits[str(one)] >> one & 1 and state[one] == STANDS):
            return False
        if one in model.on and not is_final(in_hand, model.on[one]):
            return False
        masks = table.puts.get(str(one), PutDownMasks())
        return is_free(in_hand, [*(masks.straight if state[one] == STANDS else masks.ever)])

    start = (STANDS,) * n
    picks, queue = {start: 0}, deque([start])
    while queue:
        state = queue.popleft()
        if is_done(state):
            return picks[state]
        for after in then(state):
            if after not in picks:
                picks[after] = picks[state] + 1
                queue.append(after)
    return None


def exhaustive_with_hands(model: Model) -> int | None:
    """The fewest picks with several hands: each may keep an object while others take and put down.

    An object is in a hand before it is put down, so picks and put-downs are two kinds of steps. Nothing is to be held
    in the end.
    """
    table, n = model.table, len(model.table.names)
    to_move, ends = {int(name) for name in table.to_move}, {int(name) for name in table.waits}

    def is_done(state: tuple[int, ...]) -> bool:
        wanted = (END if one in ends else ASIDE for one in range(n))
        return all(
            state[one] == want or (state[one] == STANDS and one not in to_move) for one, want in enumerate(wanted)
        )

    def is_free(state: tuple[int, ...], masks: Collection[int]) -> bool:
        return any(not any(mask >> one & 1 and state[one] == STANDS for one in range(n)) for mask in masks)

    def is_final(state: tuple[int, ...], one: int) -> bool:
        if one in ends:
            return state[one] == END or (state[one] == STANDS and one not in to_move)
        return state[one] == ASIDE or (state[one] == STANDS and one not in to_move)

    def may_take(state: tuple[int, ...], one: int) -> bool:
        if state[one] in (HELD, TAKEN) or (state[one] == STANDS and not is_free(state, model.takes[one])):
            return False
        if any(state[above] == END and below == one for above, below in model.on.items()):
            return False
        late = any(int(b) == one and not is_final(state, int(a)) for a, b in table.order)
        return not late and not any(int(a) == one and state[int(b)] != STANDS for a, b in table.order)

    def may_put(state: tuple[int, ...], one: int) -> bool:
        waits, masks = table.waits[str(one)], table.puts.get(str(one), PutDownMasks())
        if (state[one] == TAKEN and waits >> one & 1) or not is_free(state, [waits]):
            return False
        return (one not in model.on or is_final(state, model.on[one])) and is_free(
            state, masks.straight if state[one] == TAKEN else masks.ever
        )

    def then(state: tuple[int, ...]) -> Iterator[tuple[int, tuple[int, ...]]]:
        """What one step leads to, and its picks."""
        later = tuple(HELD if one == TAKEN else one for one in state)
        is_full = sum(one == HELD for one in later) == table.hands
        for one in range(n):
            if not is_full and may_take(state, one):
                yield 1, (*later[:one], TAKEN if state[one] == STANDS else HELD, *later[one + 1 :])
            if later[one] == HELD:
                yield 0, (*later[:one], ASIDE, *later[one + 1 :])
            if later[one] == HELD and one in ends and may_put(state, one):
                yield 0, (*later[:one], END, *later[one + 1 :])

    start = (STANDS,) * n
    picks, queue = {start: 0}, deque([start])
    while queue:
        state = queue.popleft()
        if is_done(state):
            return picks[state]
        for more, after in then(state):
            if picks[state] + more < picks.get(after, math.inf):
                picks[after] = picks[state] + more
                queue.append(after) if more else queue.appendleft(after)
    return None


def drawn(rng: np.random.Generator, most: int = 6) -> Model:
    """A random table: grasps, stacks, swaps, places that are occupied, put-downs that are in the way, orders."""
    n = int(rng.integers(1, most + 1))

    def mask(share: float, without: int) -> int:
        return sum(1 << one for one in range(n) if one != without and rng.random() < share)

    crowd = rng.choice([0.1, 0.3, 0.5])
    takes = [[mask(crowd, one) for _ in range(int(rng.integers(1, 4)))] for one in range(n)]
    order = [int(one) for one in rng.permutation(n)]
    to_move = order[: int(rng.integers(1, n + 1))]
    hold = to_move[:1] if rng.random() < 0.4 else []
    ends = [one for one in to_move if one not in hold and rng.random() < 0.7]
    # Stacks: an object is to stand on one that comes before it, and so do all that it waits for.
    on: dict[int, int] = {}
    for index, one in enumerate(ends):
        if index and rng.random() < 0.4 and ends[index - 1] not in on.values():
            on[one] = ends[index - 1]
    own = {one: mask(rng.choice([0.0, 0.2]), -1) for one in ends}

    def before(one: int) -> int:
        return own[one] | (before(on[one]) | 1 << on[one] if one in on else 0)

    waits = {str(one): before(one) for one in ends}
    for one in hold:  # it comes after all others
        waits[str(one)] = sum(1 << other for other in to_move if other != one)
        for other in ends:
            waits[str(one)] |= waits[str(other)]
    puts: dict[str, PutDownMasks] = {}
    for one in ends:
        if one not in on and rng.random() < 0.3:
            ever = [mask(0.3, one) for _ in range(2)]
            straight = {some | mask(0.3, one) for some in ever}
            if 0 not in straight:
                puts[str(one)] = PutDownMasks(tuple(straight), tuple(ever))
    pairs = []
    if rng.random() < 0.3 and n > 1:
        a, b = (int(one) for one in rng.choice(n, 2, replace=False))
        if a not in hold:
            pairs = [(str(a), str(b))]
    table = PickTable(
        [str(one) for one in range(n)],
        lambda name: takes[int(name)],
        [str(one) for one in to_move],
        waits,
        puts,
        {str(one): str(below) for one, below in on.items()},
        pairs,
        [str(one) for one in hold],
    )
    return Model(table, takes, on)


@pytest.mark.parametrize("seed", range(20))
def test_the_fewest_picks_are_those_of_an_exhaustive_search(seed: int) -> None:
    """Never above the minimum, and the minimum wherever it says proved; a hundred models each."""
    rng = np.random.default_rng(seed)
    proved = 0
    for _ in range(100):
        model = drawn(rng)
        proved += is_proved(model, model.table.fewest(), exhaustive(model))
    assert proved


@pytest.mark.parametrize("seed", range(5))
def test_bounds_below_a_known_number_of_picks_are_those_of_the_whole_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(100):
        model = drawn(rng)
        # The gripper alone hits a part of what the robot hits.
        parts = {
            str(one): [mask & int(rng.integers(1 << 6)) for mask in masks] for one, masks in enumerate(model.takes)
        }
        fewest, table = model.table.fewest(), replace(model.table, hits=parts.__getitem__)
        for most in range(8):
            bound = table.fewest(fewer_than=most)
            if fewest.picks is not None and fewest.picks < most:
                assert (bound.picks, bound.least, bound.proved) == (fewest.picks, fewest.least, fewest.proved)
            else:
                assert bound.picks is None
                assert bound.proved
                assert fewest.picks is None or most <= bound.least <= fewest.picks


def is_proved(model: Model, bound: LowerBound, fewest: int | None) -> bool:
    """Whether a bound says that it is the minimum. It is then, and it never is above it."""
    if fewest is None:
        assert bound.picks is None or not bound.proved, model
        return False
    assert bound.least <= fewest, model
    assert not bound.proved or bound.picks == fewest, model
    return bound.proved


@pytest.mark.parametrize("seed", range(10))
def test_with_two_hands_the_fewest_picks_are_those_of_an_exhaustive_search(seed: int) -> None:
    """Never above the minimum, and the minimum wherever it says proved. A hand saves picks in some of the models."""
    rng = np.random.default_rng(seed)
    proved = saved = 0
    for _ in range(60):
        one = drawn(rng, 5)
        if one.table.hold:
            continue
        model = one._replace(table=replace(one.table, hands=2))
        bound, fewest = model.table.fewest(), exhaustive_with_hands(model)
        if is_proved(model, bound, fewest):
            proved += 1
            saved += (bound.picks or 0) < (one.table.fewest().picks or 0)
    assert proved
    assert saved
