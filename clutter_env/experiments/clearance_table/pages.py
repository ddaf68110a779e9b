"""The clearance table as a Markdown page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from clutter_env.experiments.clearance_table.paper import PAPER, PAPER_OBJECTS
from clutter_env.experiments.clearance_table.picture import plot
from clutter_env.experiments.clearance_table.statistics import Row, Scenes, Shared
from clutter_env.experiments.clearance_table.table import Summary, TableSettings
from clutter_env.reporting.intervals import Times
from clutter_env.reporting.tables import NOTHING, markdown_section, number_text

__all__ = ["markdown", "write_page"]


def markdown(settings: TableSettings, summary: Summary) -> str:
    """All tables, one after another."""
    rows = summary.rows
    strategies = list(dict.fromkeys(row.strategy for row in rows))
    parts = [_table_1(rows, strategies), _success(rows, settings.physics), _paired(rows, strategies[0], settings.cap)]
    parts.append(_shared(summary.shared))
    if settings.compares_arms:
        parts.append(_effort(rows, strategies[0]))
    parts += [_planning_time(rows, settings.physics), _causes(rows)]
    parts.append(_scene_table(summary.scenes))
    return "\n".join(parts)


def write_page(settings: TableSettings, command: str, summary: Summary, page: Path) -> None:
    """Write the Markdown page; its picture is at `picture_path(page)`."""
    picture = picture_path(page)
    plot(summary, picture)
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
        f"![Clearance table]({picture.relative_to(page.parent)})\n\n{markdown(settings, summary)}"
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


def _shared(shared: Sequence[Shared]) -> str:
    """What the picture shows of the clearances: every strategy, and the floor, on the same scenes."""
    strategies = list(dict.fromkeys(entry.strategy for entry in shared))
    cells = {(entry.objects, entry.strategy): entry for entry in shared}
    lines = []
    for objects in dict.fromkeys(entry.objects for entry in shared):
        own = [cells[objects, name] for name in strategies]
        figures = [f"{entry.clearances} ({entry.duplicated.mean:.2f})" for entry in own]
        lines.append([str(objects), str(own[0].scenes), f"{own[0].floor:.2f}", *figures])
    title = "Scenes that every strategy solves: objects cleared (twice or more)"
    return markdown_section(title, ["N", "scenes", "floor", *strategies], lines)


def _effort(rows: Sequence[Row], reference: str) -> str:
    """Base motions and simulated time, paired."""
    head = ["N", "strategy", "base motions", f"{reference}", "fewer", "less"]
    head += ["simulated time", f"{reference}", "less [s]", "less"]
    lines = []
    for row in rows:
        moves, before, fewer, spent, reference_time, saved = row.effort
        lines.append(
            [str(row.objects), row.strategy, number_text(moves), number_text(before), str(fewer)]
            + [number_text(1 - moves / before if before else np.nan, "{:.0%}"), number_text(spent, "{:.1f} s")]
            + [number_text(reference_time, "{:.1f} s"), str(saved)]
            + [number_text(1 - spent / reference_time if reference_time else np.nan, "{:.0%}")]
        )
    return markdown_section(f"Base motions and simulated time, paired with {reference}", head, lines)


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
