"""The clearance table as a Markdown page and as plots."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from clutter_env.experiments.clearance_table.statistics import Row, Scenes
from clutter_env.experiments.clearance_table.table import TableSettings
from clutter_env.experiments.clearance_table.variants import ABLATIONS
from clutter_env.reporting.statistics import Interval, Times
from clutter_env.reporting.tables import NOTHING, markdown_section, number_text

__all__ = ["PAPER", "PAPER_OBJECTS", "markdown", "plot", "write_page"]

PAPER_OBJECTS = (15, 20, 25, 30, 35, 40)
PAPER = {
    "clearances": {"srivastava": (3.4, 6.6, 7.5, 8.2, 10.7, 11.2), "ngr": (3.0, 5.0, 5.0, 6.0, 6.0, 6.0)},
    "duplicated": {"srivastava": (0.3, 0.7, 1.2, 1.6, 2.3, 3.0), "ngr": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)},
}
"""Table 1 of Lee & Kim 2019, by strategy, for `PAPER_OBJECTS`."""
COLOURS = {"lookahead": "#0072b2", "ngr": "#009e73", "dogar": "#cc79a7", "srivastava": "#d55e00"}
COLOURS |= dict(zip(ABLATIONS, ("#56b4e9", "#e69f00", "#f0e442", "#999999"), strict=False))
"""Of the palette of Okabe & Ito (2008), which colour-blind readers can tell apart as well."""
GREY = "#777777"


def markdown(settings: TableSettings, scenes: Sequence[Scenes], rows: Sequence[Row]) -> str:
    """All tables, one after another."""
    strategies = list(dict.fromkeys(row.strategy for row in rows))
    parts = [_table_1(rows, strategies), _success(rows, settings.physics), _paired(rows, strategies[0], settings.cap)]
    parts += [_planning_time(rows, settings.physics), _causes(rows), _scene_table(scenes)]
    return "\n".join(parts)


def write_page(
    settings: TableSettings, command: str, scenes: Sequence[Scenes], rows: Sequence[Row], page: Path
) -> None:
    """Write the Markdown page; its picture is at `picture_path(page)`."""
    picture = picture_path(page)
    plot(scenes, rows, picture)
    kind = f'in physics, "{settings.control_mode}" mode' if settings.physics else "plans only"
    put = f" Objects may be put on: {' '.join(settings.supports)}." if settings.supports else ""
    which = ", whose target no level grasp reaches at once" if settings.only_obstructed else ""
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(
        f"# Clearance table ({kind})\n\n```sh\n{command}\n```\n\n"
        f"Robot {settings.robot!r}, layout {settings.layout!r}, grasp set {settings.grasps!r}: plans and minimum "
        f"numbers of clearances (floors) are for these grasps.{put} Each strategy is tried on the same scenes: resets "
        f"of the environment, from seed {settings.seed} on{which}. Success rates have Wilson's 95% interval, all other "
        "means a 95% bootstrap interval over the scenes. How to read the columns: "
        "[planners.md](planners.md#reading-the-clearance-table).\n\n"
        f"![Clearance table]({picture.relative_to(page.parent)})\n\n{markdown(settings, scenes, rows)}"
    )


def picture_path(page: Path) -> Path:
    """The picture of a page: in images/ beside it, under its name."""
    return page.parent / "images" / f"{page.stem}.png"


def _table_1(rows: Sequence[Row], strategies: Sequence[str]) -> str:
    """Table 1 of the paper, with our figures and its own."""
    cells = {(row.objects, row.strategy): row for row in rows}
    head = ["N", *(f"cleared: {name}" for name in strategies), "paper: Srivastava", "paper: NGR"]
    head += [f"twice: {name}" for name in strategies] + ["paper: Srivastava", "paper: NGR"]
    lines = []
    for objects in dict.fromkeys(row.objects for row in rows):
        own = [cells.get((objects, name)) for name in strategies]
        lines.append(
            [str(objects)]
            + [NOTHING if row is None else str(row.clearances) for row in own]
            + _of_paper("clearances", objects)
            + [NOTHING if row is None else f"{row.duplicated.mean:.2f}" for row in own]
            + _of_paper("duplicated", objects)
        )
    return markdown_section("Table 1: objects cleared, and objects cleared twice or more", head, lines)


def _of_paper(figure: str, objects: int) -> list[str]:
    if objects not in PAPER_OBJECTS:
        return [NOTHING, NOTHING]
    at = PAPER_OBJECTS.index(objects)
    return [f"{PAPER[figure][name][at]:g}" for name in ("srivastava", "ngr")]


def _success(rows: Sequence[Row], is_physics: bool) -> str:
    """Success rates; in physics those of clean success, and beside them the share of targets lifted in any way."""
    head = (
        ["N", "strategy", "solved", "clean success", "lifted"] if is_physics else ["N", "strategy", "solved", "success"]
    )
    head += ["p", "cleared / floor", "exactly the floor", "replans", "crashed"]
    lines = [
        [
            str(row.objects),
            row.strategy,
            f"{row.solved} / {row.scenes}",
            str(row.success),
            *([str(row.lifted)] if is_physics else []),
            number_text(row.p_success, "{:.2g}"),
            str(row.ratio),
            number_text(row.at_floor, "{:.0%}"),
            str(row.replans),
            str(row.crashed),
        ]
        for row in rows
    ]
    return markdown_section("Success and distance from the floor", head, lines)


def _paired(rows: Sequence[Row], reference: str, cap: int) -> str:
    head = ["N", "strategy", "both solved", "cleared", f"{reference} cleared", "difference", f"censored at {cap}"]
    lines = [
        [
            str(row.objects),
            row.strategy,
            str(row.both),
            number_text(row.both_clearances),
            number_text(row.both_reference),
            str(row.difference),
            str(row.censored),
        ]
        for row in rows
    ]
    return markdown_section(f"Paired with {reference}, scene by scene", head, lines)


def _planning_time(rows: Sequence[Row], is_physics: bool) -> str:
    """CPU times in milliseconds; in physics only the sum over all plans of an episode is known."""
    figures: dict[str, Callable[[Row], Times]] = {"whole solve": lambda row: row.total}
    if not is_physics:
        figures |= {
            "task planning": lambda row: row.task,
            "motion planning": lambda row: row.motion,
            "one task-planning call": lambda row: row.task_call,
        }
    head = ["N", "strategy", *figures]
    lines = [[str(row.objects), row.strategy, *(_times(figure(row)) for figure in figures.values())] for row in rows]
    return markdown_section("Planning time [CPU ms]: median (95th percentile)", head, lines)


def _causes(rows: Sequence[Row]) -> str:
    failed = [row for row in rows if row.causes]
    lines = [
        [str(row.objects), row.strategy, ", ".join(f"{cause}: {count}" for cause, count in sorted(row.causes.items()))]
        for row in failed
    ]
    if not lines:
        return "### Causes of failure\n\nNone failed.\n"
    return markdown_section("Causes of failure", ["N", "strategy", "causes"], lines)


def _scene_table(scenes: Sequence[Scenes]) -> str:
    head = [
        "N",
        "resets",
        "free",
        "obstructed",
        "no self-clearable set",
        "unreachable",
        "not assessed",
        "floor unproved",
    ]
    head += ["floor", "floor [CPU ms]"]
    lines = [
        [
            *map(str, (row.objects, row.seeds, row.free, row.obstructed, row.without_set, row.unreachable)),
            *map(str, (row.crashed, row.unproved)),
            str(row.floor),
            _times(row.floor_time),
        ]
        for row in scenes
    ]
    return markdown_section("Scenes", head, lines)


def _times(value: Times) -> str:
    return NOTHING if np.isnan(value.median) else f"{1e3 * value.median:.3g} ({1e3 * value.p95:.3g})"


def plot(scenes: Sequence[Scenes], rows: Sequence[Row], path: Path) -> None:
    """Draw success, clearances, repeated clearances and planning time over the number of objects."""
    figure = Figure(figsize=(11, 7.6), layout="constrained")
    success, clearances, duplicated, seconds = figure.subplots(2, 2).flat
    for strategy in dict.fromkeys(row.strategy for row in rows):
        own = sorted((row for row in rows if row.strategy == strategy), key=lambda row: row.objects)
        _band(success, own, lambda row: row.success)
        _band(clearances, own, lambda row: row.clearances)
        _band(duplicated, own, lambda row: row.duplicated)
        _band(seconds, own, lambda row: Interval(row.total.median, row.total.median, row.total.p95))
    _paper_lines(clearances, "clearances")
    _paper_lines(duplicated, "duplicated")
    floors = sorted((scene.objects, scene.floor.mean) for scene in scenes)
    clearances.plot(
        *zip(*floors, strict=True), color="black", linestyle=":", label="floor (minimum number of clearances)"
    )
    success.set(title="Share of obstructed scenes solved", ylim=(-0.02, 1.04))
    clearances.set(title="Objects cleared, scenes solved")
    duplicated.set(title="Objects cleared twice or more, scenes solved")
    seconds.set(title="CPU time of a solve [s]: median to 95th percentile", yscale="log")
    seconds.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    seconds.yaxis.set_major_formatter("{x:g}")
    seconds.yaxis.set_minor_formatter("")
    ticks = sorted({row.objects for row in rows})
    for axes in (success, clearances, duplicated, seconds):
        axes.set(xlabel="objects on the table", xticks=ticks)
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    success.legend(loc="lower left", frameon=False)
    clearances.legend(loc="upper left", frameon=False, fontsize="small", ncols=2)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)


def _band(axes: Axes, own: Sequence[Row], figure: Callable[[Row], Interval]) -> None:
    name = own[0].strategy
    values = np.array([figure(row) for row in own])
    numbers = [row.objects for row in own]
    colour = COLOURS.get(name, GREY)
    axes.plot(numbers, values[:, 0], marker="o", markersize=4, color=colour, label=name)
    axes.fill_between(numbers, values[:, 1], values[:, 2], color=colour, alpha=0.15, linewidth=0)


def _paper_lines(axes: Axes, figure: str) -> None:
    for name, values in PAPER[figure].items():
        label = f"paper: {'NGR' if name == 'ngr' else 'Srivastava'}"
        axes.plot(PAPER_OBJECTS, values, color=COLOURS[name], linestyle="--", linewidth=1, alpha=0.8, label=label)
