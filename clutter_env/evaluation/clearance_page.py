"""Figures of a clearance table, paired by scene and with 95% intervals; its Markdown page and its picture."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from clutter_env.evaluation.clearance_table import CRASH, Assessment, Attempt, Table
from clutter_env.reporting.intervals import Interval, Times, bootstrap, times, wilson
from clutter_env.reporting.tables import NOTHING, markdown_section, number_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Row: TypeAlias = dict[str, Any]
Summary: TypeAlias = dict[str, list[Row]]

PAPER_OBJECTS = (15, 20, 25, 30, 35, 40)
PAPER = {
    "clearances": {"srivastava": (3.4, 6.6, 7.5, 8.2, 10.7, 11.2), "ngr": (3.0, 5.0, 5.0, 6.0, 6.0, 6.0)},
    "duplicated": {"srivastava": (0.3, 0.7, 1.2, 1.6, 2.3, 3.0), "ngr": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)},
}
"""Table 1 of Lee & Kim 2019: objects cleared, and objects cleared twice or more, for `PAPER_OBJECTS`."""

COLOURS = {"lookahead": "#0072b2", "ngr": "#009e73", "dogar": "#cc79a7", "srivastava": "#d55e00"}
OTHER_COLOURS = ("#56b4e9", "#e69f00", "#f0e442", "#999999")
"""Of the palette of Okabe & Ito (2008), which colour-blind readers can tell apart as well."""
_BESIDE = 0.16
"""Distance of neighbouring strategies, in steps between numbers of objects, so that no interval hides another one."""
_FLOOR = 0.36
"""Half the length of the black line that marks the minimum number of clearances, in the same steps."""


def summarise(table: Table, cap: int = 20) -> Summary:
    """The figures of the trials that there are.

    Args:
        table: whose first row is the reference that the others are compared with.
        cap: number of clearances that an unsolved scene counts as in the censored mean.

    Returns:
        "scenes": one entry for each number of objects; "rows": one for each of them and each strategy; "shared": the
        same on the scenes that every strategy solved and whose floor is proved.
    """
    summary: Summary = {"scenes": [], "rows": [], "shared": []}
    seed = table.common.seed
    for objects in table.objects:
        seeds = table.seeds(objects)
        if not seeds:
            continue
        found = {k: scene for k, scene in table.assessments(objects).items() if seed <= k <= seeds[-1]}
        floors = {k: scene.floor for k, scene in found.items() if scene.proved and scene.floor is not None}
        attempts = {name: table.attempts(objects, name) for name in table.variants}
        reference = next(iter(attempts.values()))
        tried = {name: own for name, own in attempts.items() if own}
        summary["scenes"].append(scene_row(objects, list(found.values()), seed))
        summary["rows"] += [row(own, reference, floors, cap, seed) for own in tried.values()]
        summary["shared"] += shared_rows(tried, floors, objects, seed)
    return summary


def scene_row(objects: int, found: Sequence[Assessment], seed: int) -> Row:
    """Numbers of assessed scenes, by what their floors say.

    A scene is obstructed if something has to be cleared before a level gripper takes the target, whatever the grasps
    of the table. `seed` is of the bootstrap.
    """
    obstructed = [scene for scene in found if scene.is_obstructed]
    proved = [scene.floor for scene in obstructed if scene.proved and scene.floor is not None]
    causes = Counter(scene.cause for scene in found if scene.floor is None)
    return {
        "objects": objects,
        "seeds": len(found),
        "free": sum(scene.side_floor == 0 for scene in found),
        "obstructed": len(obstructed),
        "without_set": causes.total() - causes[CRASH] - causes["unreachable"],
        "unreachable": causes["unreachable"],
        "crashed": causes[CRASH],
        "unproved": len(obstructed) - len(proved),
        "floor": bootstrap([proved], np.random.default_rng(seed)),
        "floor_time": times([scene.floor_s for scene in found]),
    }


def row(
    own: Mapping[int, Attempt], reference: Mapping[int, Attempt], floors: Mapping[int, int], cap: int, seed: int
) -> Row:
    """The figures of one strategy; attempts that crashed are counted nowhere but in "crashed".

    Args:
        own: its attempts by seed of the scene, at least one.
        reference: those of the strategy that it is compared with; may be `own` itself.
        floors: proved minimum numbers of clearances by seed of the scene.
        cap: number of clearances that an unsolved scene counts as.
        seed: of the bootstrap.
    """
    rng = np.random.default_rng(seed)
    first = next(iter(own.values()))
    ended = {k: attempt for k, attempt in own.items() if attempt.cause != CRASH}
    solved = {k: attempt for k, attempt in ended.items() if attempt.solved}
    both = [k for k in solved if k in reference and reference[k].solved]
    floored = [(len(solved[k].clearances), floors[k]) for k in solved if k in floors]
    differences = [len(own[k].clearances) - len(reference[k].clearances) for k in both]
    return {
        "objects": first.objects,
        "strategy": first.strategy,
        "scenes": len(ended),
        "crashed": len(own) - len(ended),
        "solved": len(solved),
        "success": wilson(len(solved), len(ended)),
        "lifted": wilson(sum(attempt.lifted for attempt in ended.values()), len(ended)),
        "clearances": bootstrap([[len(attempt.clearances) for attempt in solved.values()]], rng),
        "duplicated": bootstrap([[attempt.duplicated for attempt in solved.values()]], rng),
        "ratio": bootstrap([[count / floor for count, floor in floored if floor]], rng),
        "at_floor": _mean([float(count <= floor) for count, floor in floored]),
        "both": len(both),
        "both_clearances": _mean([len(own[k].clearances) for k in both]),
        "both_reference": _mean([len(reference[k].clearances) for k in both]),
        "difference": bootstrap([differences], rng),
        "censored": bootstrap([[min(len(a.clearances), cap) if a.solved else cap for a in ended.values()]], rng),
        "p_success": np.nan if own is reference else mcnemar(ended, reference),
        "replans": bootstrap([[attempt.replans for attempt in ended.values()]], rng),
        "total": times([attempt.total_s for attempt in ended.values()]),
        "task": times([attempt.task_planning_s for attempt in ended.values()]),
        "motion": times([attempt.motion_planning_s for attempt in ended.values()]),
        "task_call": times([a.task_planning_s / a.task_plans for a in ended.values() if a.task_plans]),
        "causes": Counter(attempt.cause for attempt in ended.values() if not attempt.solved),
    }


def mcnemar(own: Mapping[int, Attempt], reference: Mapping[int, Attempt]) -> float:
    """Two-sided p value of McNemar's exact test that both strategies solve the same share of the scenes.

    The test is binomial over the scenes that only one of the two solves; NaN if no scene was tried by both.
    """
    from scipy.stats import binomtest

    both = [(own[k].solved, reference[k].solved) for k in own if k in reference and reference[k].cause != CRASH]
    only_own = sum(mine and not theirs for mine, theirs in both)
    only_reference = sum(theirs and not mine for mine, theirs in both)
    if not only_own + only_reference:
        return 1.0 if both else np.nan
    return float(binomtest(only_own, only_own + only_reference).pvalue)


def shared_rows(
    attempts: Mapping[str, Mapping[int, Attempt]], floors: Mapping[int, int], objects: int, seed: int
) -> list[Row]:
    """All strategies, and the mean floor, on the scenes that every one of them solved and whose floor is proved."""
    solved = [{k for k, attempt in own.items() if attempt.solved} for own in attempts.values()]
    scenes = sorted(set(floors).intersection(*solved)) if solved else []
    if not scenes:
        return []
    return [
        {
            "objects": objects,
            "strategy": name,
            "scenes": len(scenes),
            "floor": _mean([floors[k] for k in scenes]),
            "clearances": bootstrap([[len(own[k].clearances) for k in scenes]], np.random.default_rng(seed)),
            "duplicated": bootstrap([[own[k].duplicated for k in scenes]], np.random.default_rng(seed)),
        }
        for name, own in attempts.items()
    ]


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else np.nan


def markdown(summary: Summary, is_physics: bool, cap: int = 20) -> str:
    """All tables, one after another."""
    rows, shared = summary["rows"], summary["shared"]
    names = list(dict.fromkeys(entry["strategy"] for entry in rows))
    counts = list(dict.fromkeys(entry["objects"] for entry in rows))
    cells = {(entry["objects"], entry["strategy"]): entry for entry in rows}
    of_shared = {(entry["objects"], entry["strategy"]): entry for entry in shared}

    def paper(figure: str, objects: int) -> list[str]:
        if objects not in PAPER_OBJECTS:
            return [NOTHING, NOTHING]
        return [f"{PAPER[figure][name][PAPER_OBJECTS.index(objects)]:g}" for name in ("srivastava", "ngr")]

    def of_each(text: str, entries: list[Row | None]) -> list[str]:
        return [NOTHING if entry is None else text.format(**entry) for entry in entries]

    table_1, on_shared = [], []
    for n in counts:
        own = [cells.get((n, name)) for name in names]
        cleared = [*of_each("{clearances}", own), *paper("clearances", n)]
        table_1.append([str(n), *cleared, *of_each("{duplicated.mean:.2f}", own), *paper("duplicated", n)])
        if all((n, name) in of_shared for name in names):
            entries: list[Row | None] = [of_shared[n, name] for name in names]
            head = of_each("{scenes}|{floor:.2f}", entries[:1])[0].split("|")
            on_shared.append([str(n), *head, *of_each("{clearances} ({duplicated.mean:.2f})", entries)])
    of_paper = ["paper: Srivastava", "paper: NGR"]
    head_1 = ["N", *(f"cleared: {name}" for name in names), *of_paper, *(f"twice: {name}" for name in names), *of_paper]
    planning = {"whole solve": "total"}
    if not is_physics:  # where only the sum over all plans of an episode is known
        planning |= {"task planning": "task", "motion planning": "motion", "one task-planning call": "task_call"}
    success = {"clean success": "{success}", "lifted": "{lifted}"} if is_physics else {"success": "{success}"}
    causes = [
        [str(r["objects"]), r["strategy"], ", ".join(f"{cause}: {n}" for cause, n in sorted(r["causes"].items()))]
        for r in rows
        if r["causes"]
    ]
    parts = [
        markdown_section("Table 1: objects cleared, and objects cleared twice or more", head_1, table_1),
        _section(
            "Success and distance from the lower bound",
            rows,
            {"N": "{objects}", "strategy": "{strategy}", "solved": "{solved} / {scenes}", **success}
            | {"p": "{p_success:.2g}", "cleared / lower bound": "{ratio}", "exactly the lower bound": "{at_floor:.0%}"}
            | {"replans": "{replans}", "crashed": "{crashed}"},
        ),
        _section(
            f"Paired with {names[0]}, scene by scene",
            rows,
            {"N": "{objects}", "strategy": "{strategy}", "both solved": "{both}", "cleared": "{both_clearances:.2f}"}
            | {f"{names[0]} cleared": "{both_reference:.2f}", "difference": "{difference}"}
            | {f"censored at {cap}": "{censored}"},
        ),
        markdown_section(
            "Scenes that every strategy solves: objects cleared (twice or more)",
            ["N", "scenes", "lower bound", *names],
            on_shared,
        ),
        markdown_section(
            "Planning time [CPU ms]: median (95th percentile)",
            ["N", "strategy", *planning],
            [[str(r["objects"]), r["strategy"], *(_milliseconds(r[name]) for name in planning.values())] for r in rows],
        ),
        markdown_section("Causes of failure", ["N", "strategy", "causes"], causes)
        if causes
        else "### Causes of failure\n\nNone failed.\n",
        _section(
            "Scenes",
            [{**entry, "floor_time": _milliseconds(entry["floor_time"])} for entry in summary["scenes"]],
            {"N": "{objects}", "resets": "{seeds}", "free": "{free}", "obstructed": "{obstructed}"}
            | {"no self-clearable set": "{without_set}", "unreachable": "{unreachable}", "not assessed": "{crashed}"}
            | {"lower bound unproved": "{unproved}", "lower bound": "{floor}", "lower bound [CPU ms]": "{floor_time}"},
        ),
    ]
    return "\n".join(parts)


def _section(title: str, rows: Sequence[Row], columns: Mapping[str, str]) -> str:
    """A table with one line for each row; `columns` are formats by heading, NaN becomes a dash."""

    def cell(text: str, entry: Row) -> str:
        filled = text.format(**entry)
        return NOTHING if filled in ("nan", "nan%") else filled

    return markdown_section(title, list(columns), [[cell(text, entry) for text in columns.values()] for entry in rows])


def _milliseconds(value: Times) -> str:
    return number_text(value.median * 1e3, f"{{:.3g}} ({1e3 * value.p95:.3g})")


def write_page(table: Table, command: str, summary: Summary, page: Path, cap: int = 20) -> None:
    """Write the Markdown page, and its picture to images/ beside it."""
    picture = page.parent / "images" / f"{page.stem}.png"
    picture.parent.mkdir(parents=True, exist_ok=True)
    draw(summary).savefig(picture, dpi=130)
    common = table.common
    kind = f'in physics, "{common.control_mode}" mode' if common.physics else "plans only"
    put = f" Objects may be put on: {' '.join(common.supports)}." if common.supports else ""
    which = ", whose target no level grasp reaches at once" if table.only_obstructed else ""
    page.write_text(
        f"# Clearance table ({kind})\n\n```sh\n{command}\n```\n\n"
        f"Robot {common.robot!r}, layout {common.layout!r}, grasp set {common.grasps!r}: plans and lower "
        f"bounds are for these grasps.{put} Each strategy is tried on the same scenes: resets "
        f"of the environment, from seed {common.seed} on{which}. Success rates have Wilson's 95% interval, all other "
        "means a 95% bootstrap interval over the scenes. What the words mean: docs/glossary.md.\n\n"
        f"![Clearance table]({picture.relative_to(page.parent)})\n\n{markdown(summary, common.physics, cap)}"
    )


def draw(summary: Summary) -> Figure:
    """Success and planning time of all scenes; clearances and the floor of the scenes that every strategy solves."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.ticker import LogLocator

    figure = Figure(figsize=(11, 7.6), layout="constrained")
    success, clearances, duplicated, seconds = figure.subplots(2, 2).flat
    objects = sorted({entry["objects"] for entry in summary["rows"]})
    strategies = list(dict.fromkeys(entry["strategy"] for entry in summary["rows"]))
    others = iter(OTHER_COLOURS)
    colours = {name: COLOURS.get(name) or next(others, "#777777") for name in strategies}
    for index, name in enumerate(strategies):
        rows = [entry for entry in summary["rows"] if entry["strategy"] == name]
        shared = [entry for entry in summary["shared"] if entry["strategy"] == name]
        solve_times = [Interval(entry["total"].median, entry["total"].median, entry["total"].p95) for entry in rows]
        for axes, own, values in (
            (success, rows, [entry["success"] for entry in rows]),
            (clearances, shared, [entry["clearances"] for entry in shared]),
            (duplicated, shared, [entry["duplicated"] for entry in shared]),
            (seconds, rows, solve_times),
        ):
            if own:
                mean, low, high = np.array(values).T
                shift = _BESIDE * (index - (len(strategies) - 1) / 2)
                places = [objects.index(entry["objects"]) + shift for entry in own]
                reach, style = np.maximum([mean - low, high - mean], 0.0), {"markersize": 5, "elinewidth": 1.4}
                axes.errorbar(places, mean, reach, label=name, fmt="o", capsize=2.5, color=colours[name], **style)
    scenes = {entry["objects"]: entry for entry in summary["shared"]}
    for number, entry in scenes.items():
        at = objects.index(number)
        ends, heights = [at - _FLOOR, at + _FLOOR], [entry["floor"]] * 2
        clearances.plot(ends, heights, color="black", linewidth=1.4, zorder=1, gid="floor")
    legend = [Line2D([], [], color="black", linewidth=1.4, label="lower bound of the same scenes")]
    dashed: dict[str, Any] = {"linestyle": "--", "linewidth": 1, "alpha": 0.6}
    for name, said in (("srivastava", "Srivastava"), ("ngr", "NGR")):
        legend.append(Line2D([], [], color=COLOURS[name], label=f"{said} in the paper (other scenes)", **dashed))
        for axes, figure_name in ((clearances, "clearances"), (duplicated, "duplicated")):
            printed = zip(PAPER_OBJECTS, PAPER[figure_name][name], strict=True)
            known = [(objects.index(n), value) for n, value in printed if n in objects]
            if known:
                axes.plot(*zip(*known, strict=True), color=COLOURS[name], zorder=0, **dashed)
    success.set(title="Share of scenes solved\nand its 95% interval", ylim=(-0.02, 1.04))
    clearances.set(title="Objects cleared\nscenes that every strategy solves", ylim=(0, None))
    duplicated.set(title="Objects cleared twice or more\nscenes that every strategy solves")
    seconds.set(title="CPU time of a solve [s]\nmedian, and line to the 95th percentile", yscale="log")
    seconds.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    seconds.yaxis.set_major_formatter("{x:g}")
    seconds.yaxis.set_minor_formatter("")
    counts = {number: entry["scenes"] for number, entry in scenes.items()}
    plain = [str(number) for number in objects]
    counted = [f"{number}\nscenes: {counts.get(number, 0)}" for number in objects]
    for axes, labels in ((success, plain), (clearances, counted), (duplicated, counted), (seconds, plain)):
        _finish(axes, labels)
    success.legend(loc="lower left", frameon=False)
    clearances.legend(handles=legend, loc="upper left", frameon=False, fontsize="small")
    return figure


def _finish(axes: Axes, labels: Sequence[str]) -> None:
    """Label the numbers of objects, and leave away what no reader needs."""
    axes.set_xticks(range(len(labels)), labels)
    axes.set_xlabel("objects on the table")
    axes.grid(alpha=0.25, axis="y")
    axes.spines[["top", "right"]].set_visible(False)
