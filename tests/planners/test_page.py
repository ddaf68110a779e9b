"""The examples of docs/planners.md run as they stand, and its tables say what the code does."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

from planners import STRATEGIES, Cause, Strategy

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "planners.md").read_text(encoding="utf-8")


def test_the_examples_run() -> None:
    """All but the episode in physics, which the README's example covers."""
    first, *others = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    planning, _, _ = first.partition("expert = ")
    names: dict[str, object] = {}
    for example in (planning, *others):
        exec(compile(example, "docs/planners.md", "exec"), names)
    assert {"solution", "random_ngr", "BreadthFirst"} <= set(names)


def test_every_cause_and_every_field_of_a_strategy_is_described() -> None:
    for cause in Cause:
        assert f"| `{cause}` |" in PAGE
    for field in fields(Strategy):
        assert field.name == "name" or f"`{field.name}`" in PAGE, field.name


def test_the_table_of_strategies_is_that_of_the_code() -> None:
    for name, strategy in STRATEGIES.items():
        line = next(line for line in PAGE.splitlines() if line.startswith(f"| `{name}`"))
        for value in (strategy.grasps, strategy.region, strategy.locations):
            assert f'"{value}"' in line, (name, value)


def test_the_budget_in_the_table_is_that_of_the_code() -> None:
    strategy = STRATEGIES["ngr"]
    for name in ("attempts", "locations_per_level", "placements", "leaves_cleared"):
        assert f"| `{name}` | {str(getattr(strategy, name)).lower()} |" in PAGE


def test_the_files_of_the_page_exist() -> None:
    rooms = re.findall(r"^\| [^|]* \| (?:`(\w+)/`)? *\| (.*) \|$", PAGE.split("## Where things are")[1], re.MULTILINE)
    assert len(rooms) > 10
    for room, files in rooms:
        for name in re.findall(r"`(\w+)`", files):
            assert (ROOT / "planners" / room / f"{name}.py").is_file(), (room, name)
