"""A plan from above: one picture for each clearance, and the table before the target is taken."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from planners.drawing.choices import Choice, choices_of, final_scene
from planners.drawing.region import ClearancePicture, draw_clearance, draw_legend
from planners.placing.negative_goal_region import NegativeGoalRegion
from planners.scene import Scene
from planners.strategies import Strategy
from planners.tamp.solution import Solution

__all__ = ["draw_plan"]

_COLUMNS = 3
_MOST = 11
"""Pictures at most; of a longer plan the first ones are drawn."""


def draw_plan(solution: Solution, scene: Scene, target: str, strategy: Strategy, path: Path) -> None:
    """Write the picture of a plan made for this scene."""
    choices = choices_of(solution, scene, target, strategy)
    pictures = [(_title(number, choice), choice.picture) for number, choice in enumerate(choices[:_MOST], start=1)]
    pictures.append((f"{len(choices) + 1}  the way to {target} is free", _last(choices, solution, scene, target)))
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
    away = f" (in the way of {choice.blocked})" if choice.blocked else ""
    drives = "" if np.allclose(choice.base, choice.put_base, atol=1e-3) else ", after a drive"
    return f"{number}  {choice.name}{away}{drives}"


def _last(choices: Sequence[Choice], solution: Solution, scene: Scene, target: str) -> ClearancePicture:
    """The table when everything has been cleared, with what taking the target sweeps."""
    if not choices:
        raise ValueError("a plan without clearances has nothing to draw")
    before = choices[-1].picture
    return ClearancePicture(
        before.grid,
        NegativeGoalRegion(before.region.ngr1, before.grid.empty()),
        final_scene(solution, scene).objects,
        target,
        cleared=[choice.name for choice in choices],
        stands=solution.actions[-1].trajectory.base[-1:, :2],
        outlines=before.outlines,
    )
