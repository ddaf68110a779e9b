"""Plans of a checkout are timed in a process of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripts.solve_cost import Checkout


@pytest.mark.parametrize("task", ["", "sort"])
def test_plans_of_a_checkout_are_timed_in_a_process_of_its_own(task: str) -> None:
    checkout = Checkout(Path(__file__).parents[2], task, objects=4 if task else 5, grasps="all")
    (spent, picks), (again, same) = checkout.solve(0), checkout.solve(0)
    checkout.close()
    assert min(spent, again) > 0.0
    assert picks == same > 0
