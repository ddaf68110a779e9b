"""Markdown tables."""

from __future__ import annotations

import math
from collections.abc import Sequence

NOTHING = "–"
"""Text of a cell without a value."""


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table with one line per row, and a newline at its end.

    Raises:
        ValueError: the number of cells of a row differs from that of the head.
    """
    for row in rows:
        if len(row) != len(head):
            raise ValueError(f"a row has {len(row)} cells, and the head {len(head)}: {row}")
    return "".join(f"| {' | '.join(cells)} |\n" for cells in [head, ["---"] * len(head), *rows])


def number_text(value: float | None, pattern: str = "{:.2f}") -> str:
    """A number as text, `NOTHING` for None and NaN."""
    return NOTHING if value is None or math.isnan(value) else pattern.format(value)
