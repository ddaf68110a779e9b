"""The differences between policies in the first table of docs/results.md that 100 scenes each can show.

    python -m scripts.table_differences

The table has rates, not verdicts by scene: so its differences are tested as if the policies had played other scenes,
by the interval of Newcombe 1998, which shows less than the paired test of `clutter-env audit --files`.
"""

from __future__ import annotations

import re
from itertools import combinations, pairwise
from pathlib import Path

from clutter_env.reporting.intervals import newcombe
from clutter_env.reporting.tables import markdown_table

PAGE = Path(__file__).parents[1] / "docs" / "results.md"
SCENES = 100
"""Of each suite, as the page says."""


def rates(page: str) -> dict[str, list[int]]:
    """Clean successes of 100 by suite, of the policies that have played it; the first table of a page."""
    lines = page.split("\n|", 1)[1].split("\n\n", 1)[0].splitlines()[2:]
    rows = [[cell.strip() for cell in line.replace("**", "").strip("|").split("|")] for line in lines]
    return {
        name.strip("`*"): [round(SCENES * float(cell.split()[0])) for cell in cells if re.match(r"\d", cell)]
        for name, *cells in rows
    }


def is_shown(one: int, other: int) -> bool:
    """Whether the interval of the difference leaves out 0."""
    return newcombe((max(one, other), SCENES), (min(one, other), SCENES)).low > 0


def main() -> None:
    """Count, and print."""
    found = rates(PAGE.read_text())
    rows = []
    for what, pairs in {
        "all pairs of policies on a suite": [pair for won in found.values() for pair in combinations(won, 2)],
        "neighbours in rank": [pair for won in found.values() for pair in pairwise(sorted(won))],
    }.items():
        differing = [pair for pair in pairs if pair[0] != pair[1]]
        shown = sum(is_shown(*pair) for pair in differing)
        rows.append([what, str(len(pairs)), str(len(differing)), f"{shown} ({shown / len(differing):.0%})"])
    print(markdown_table(["pairs", "number", "with different rates", "significant"], rows))


if __name__ == "__main__":
    main()
