"""Which obstacles a refusal to put something down names."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from planners.placing import why_not
from planners.placing.goal_places import Place
from planners.scene import StaticObstacle


def box(number: int) -> StaticObstacle:
    return StaticObstacle(f"wall {number}", np.zeros(3), np.full(3, 0.1), "box", np.eye(3))


@pytest.mark.parametrize("seed", range(20))
def test_the_obstacles_named_are_those_left_when_each_in_turn_is_left_out(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    """Each test of a cabinet of 26 walls takes a second: one by one, refusing LIBERO's bowl took a minute."""
    rng, walls = np.random.default_rng(seed), [box(number) for number in range(26)]
    together = [set(rng.choice(26, size=rng.integers(1, 4), replace=False).tolist()) for _ in range(3)]
    asked: list[int] = []

    def are_enough(things: list[StaticObstacle]) -> bool:
        numbers = {number for number, wall in enumerate(walls) if any(wall is one for one in things)}
        return any(some <= numbers for some in together)

    def counted(_hands: object, _falls: object, _place: object, things: list[StaticObstacle]) -> bool:
        asked.append(len(things))
        return are_enough(things)

    left = list(walls)
    for wall in walls:
        fewer = [one for one in left if one is not wall]
        left = fewer if fewer and are_enough(fewer) else left
    monkeypatch.setattr(why_not, "_are_enough", counted)
    found = why_not._least((), (), cast(Place, None), walls)
    assert [one.name for one in found] == [one.name for one in left]
    assert len(asked) < len(walls)
