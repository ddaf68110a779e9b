"""The loop over an episode: who ends it, and what each step is told."""

from __future__ import annotations

from typing import Any

import pytest

from clutter_env.policies.playing import played


class Counter:
    """Returns the observation, and gives up after so many actions."""

    def __init__(self, most: int) -> None:
        self._left = most

    @property
    def done(self) -> bool:
        return self._left == 0

    def act(self, observation: int) -> int:
        self._left -= 1
        return observation


def step(action: int) -> tuple[Any, ...]:
    """An environment that counts, and ends at 3 by success, or at 103 by its time."""
    return action + 1, 0.5, action + 1 == 3, action + 1 == 103, {"number": action + 1}


@pytest.mark.parametrize(("first", "most", "steps"), [(0, 9, 3), (100, 9, 3), (0, 2, 2), (0, 0, 0)])
def test_an_episode_ends_with_the_environment_or_the_policy(first: int, most: int, steps: int) -> None:
    assert [one.action for one in played(Counter(most), step, first)] == list(range(first, first + steps))


def test_a_policy_that_cannot_give_up_is_stopped_by_who_iterates() -> None:
    policy = Counter(-1)
    for number, one in enumerate(played(policy, step, 10), start=1):
        assert one.info == {"number": one.observation}
        assert one.reward == 0.5
        if number == 5:
            break
    assert policy.act(0) == 0
    assert policy._left == -7
