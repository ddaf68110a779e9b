"""The page about the user's own scene: its Python runs from top to bottom, and the plan keeps clear of the pillar."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from planners import Solution
from tests.planners.own_scenes import deepest

PAGE = Path(__file__).resolve().parents[1] / "docs" / "your_own_scene.md"


def test_the_example_runs_and_its_plan_keeps_clear(capsys: Any) -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert len(blocks) == 2
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    printed = capsys.readouterr().out
    assert "movable: can tea rice salt flour sugar" in printed
    assert "static obstacles: wall pillar leg plate" in printed
    solution = names["solution"]
    assert isinstance(solution, Solution)
    assert solution.actions[-1].name == "PickUp"
    assert solution.actions[-1].target == "can"
    assert deepest(names["model"], solution, ("pillar", "plate", "leg", "wall"))[0] <= 0.001
    assert len(names["scene"].static_obstacles) == 4
