"""A plan from above: one picture for each clearance, and the table before the target is taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from planners.drawing.choices import Choice, choices_of, last_picture
from planners.drawing.region import draw_clearance, draw_legend
from planners.tamp.solution import Solution

__all__ = ["draw_plan"]

_COLUMNS, _COLUMNS_WIDE, _WIDE = 3, 2, 2.0
"""Pictures side by side, and how many of them where one is so many times as wide as it is high."""
_PAGE, _TITLE, _LEGEND = 13.8, 0.45, 0.7
"""[inch] Width of all pictures, heights of a title and of the legend."""
_MOST = 11
"""Clearances drawn at most; of a longer plan the first ones are drawn."""


def draw_plan(solution: Solution, path: Path) -> None:
    """Write the pictures of a plan's clearances (Figs. 8-10 of Lee & Kim 2019) to one image file.

    Raises:
        ValueError: the plan has no actions.
    """
    choices = choices_of(solution)
    pictures = [(_title(number, choice), choice.picture) for number, choice in enumerate(choices[:_MOST], start=1)]
    pictures.append((f"{len(choices) + 1}  {solution.target} can be taken", last_picture(solution)))
    x_low, x_high, y_low, y_high = pictures[0][1].extent
    aspect = (y_high - y_low) / (x_high - x_low)
    most = _COLUMNS if aspect < _WIDE else _COLUMNS_WIDE
    columns, width = min(most, len(pictures)), _PAGE / most
    rows = -(-len(pictures) // columns)
    figure = Figure(figsize=(width * columns, (width / aspect + _TITLE) * rows + _LEGEND), layout="constrained")
    all_axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for axes, (title, picture) in zip(all_axes, pictures, strict=False):
        draw_clearance(axes, picture, title)
    for axes in all_axes[len(pictures) :]:
        axes.set_axis_off()
    draw_legend(figure, 2 * columns)
    figure.savefig(path, dpi=130)


def _title(number: int, choice: Choice) -> str:
    because = f" (obstructs {choice.obstructed})" if choice.obstructed else ""
    return f"{number}  {choice.name}{because}{', after a drive' if choice.is_far else ''}"
