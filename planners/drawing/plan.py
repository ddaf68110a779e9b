"""A plan from above: one picture for each clearance, and the table before the target is taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from planners.drawing.choices import Choice, choices_of, last_picture
from planners.drawing.region import draw_clearance, draw_legend
from planners.tamp.solution import Solution

__all__ = ["draw_plan"]

_COLUMNS = 3
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
    columns = min(_COLUMNS, len(pictures))
    rows = -(-len(pictures) // columns)
    figure = Figure(figsize=(4.6 * columns, 3.4 * rows + 0.5), layout="constrained")
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
