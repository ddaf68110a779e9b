"""Pictures of a search from above, one for each decision: where the target can be, and what is known by then."""

from __future__ import annotations

import math
from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from planners.drawing.pictures import COLOURS
from planners.search.expert import SearchStep

_SIZE = 3.4
"""[inch] of one picture."""
_COLUMNS = 4


def draw_search(steps: Sequence[SearchStep]) -> Figure:
    """Draw the decisions of a search: places of the target red, known objects grey, the camera a triangle."""
    columns = min(len(steps), _COLUMNS) or 1
    lines = math.ceil(len(steps) / columns) or 1
    figure = plt.figure(figsize=(_SIZE * columns, _SIZE * lines), layout="constrained")
    for number, step in enumerate(steps):
        ax = figure.add_subplot(lines, columns, number + 1)
        for support, cells in step.places.items():
            x0, x1, y0, y1 = step.extents[support]
            ax.add_patch(Rectangle((y0, x0), y1 - y0, x1 - x0, facecolor=COLOURS["table"], edgecolor=COLOURS["ink"]))
            shown = np.ma.masked_where(~cells, cells)
            ax.imshow(shown, extent=(y0, y1, x0, x1), origin="lower", cmap="autumn", vmin=0, vmax=9, zorder=2)
        for seen in step.known:
            body, colour = seen.body, COLOURS["target"] if seen.is_target else COLOURS["object"]
            x, y = body.position[:2]
            if body.shape == "cylinder":
                ax.add_patch(Circle((y, x), body.half_extents[0], facecolor=colour, edgecolor="k", zorder=3))
            else:
                half_x, half_y = body.half_extents[:2]
                corner, turn = (y - half_y, x - half_x), -math.degrees(body.yaw)
                box = Rectangle(
                    corner, 2 * half_y, 2 * half_x, angle=turn, rotation_point="center", facecolor=colour, zorder=3
                )
                box.set_edgecolor("k")
                ax.add_patch(box)
        ax.plot(step.eye[1], step.eye[0], "^", color=COLOURS["ink"])
        ax.set_title(f"{step.time:.0f} s: {step.text}", fontsize=8)
        ax.set_aspect("equal")
        ax.autoscale_view()
        ax.invert_xaxis()  # y to the left, as the robot sees it
        ax.axis("off")
    return figure
