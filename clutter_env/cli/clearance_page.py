"""Figures of a clearance table, paired by scene and with 95% intervals; its Markdown page and its picture."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from clutter_env.cli.clearance_trials import CRASH, Record, Trials
from clutter_env.reporting.intervals import NO_INTERVAL, Interval, Times, bootstrap, times, wilson
from clutter_env.reporting.tables import NOTHING, markdown_section, number_text

if TYPE_CHECKING:
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
"""Half the length of the black line that marks the lower bound, in the same steps."""


def summarise(trials: Trials) -> Summary:
    """The figures of the trials that there are.

    Returns:
        "scenes": one entry for each number of objects; "rows": one for each of them and each strategy.
    """
    summary: Summary = {"scenes": [], "rows": []}
    seed = trials.arguments.seed
    for objects in trials.arguments.objects:
        if seeds := trials.seeds(objects):
            found = [scene for k, scene in trials.assessments(objects).items() if k <= seeds[-1]]
            summary["scenes"].append(scene_row(objects, found, seed))
            attempts = {name: trials.attempts(objects, name) for name in trials.variants}
            summary["rows"] += strategy_rows(attempts, trials.floors(objects), seed)
    return summary


def scene_row(objects: int, found: Sequence[Record], seed: int) -> Row:
    """Numbers of assessed scenes, by what their lower bounds say.

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
        "floor_time": times([scene.total_s for scene in found]),
    }


def strategy_rows(attempts: Mapping[str, Mapping[int, Record]], floors: Mapping[int, int], seed: int) -> list[Row]:
    """The figures of every strategy; attempts that crashed are counted nowhere but in "crashed".

    Those that begin with "both" are over the scenes that the strategy and the first one solved; those with "shared"
    over the scenes that all strategies solved and whose lower bound is proved.

    Args:
        attempts: by strategy, then by seed of the scene, all with the same number of objects.
        floors: proved lower bounds by seed of the scene.
        seed: of the bootstrap.
    """
    reference = next(iter(attempts.values()))
    tried = {name: own for name, own in attempts.items() if own}
    of_all = [{k for k, attempt in own.items() if attempt.solved} for own in tried.values()]
    shared = sorted(set(floors).intersection(*of_all))
    return [_row(own, reference, floors, shared, np.random.default_rng(seed)) for own in tried.values()]


def _row(
    own: Mapping[int, Record],
    reference: Mapping[int, Record],
    floors: Mapping[int, int],
    shared: Sequence[int],
    rng: np.random.Generator,
) -> Row:
    first = next(iter(own.values()))
    ended = {k: attempt for k, attempt in own.items() if attempt.cause != CRASH}
    cleared = {k: len(attempt.clearances) for k, attempt in ended.items() if attempt.solved}
    both = {k: len(reference[k].clearances) for k in cleared if k in reference and reference[k].solved}

    def mean(values: Sequence[float]) -> Interval:
        return bootstrap([values], rng)

    return {
        "objects": first.objects,
        "strategy": first.strategy,
        "scenes": len(ended),
        "crashed": len(own) - len(ended),
        "solved": len(cleared),
        "success": wilson(len(cleared), len(ended)),
        "lifted": wilson(sum(attempt.lifted for attempt in ended.values()), len(ended)),
        "p_success": np.nan if own is reference else mcnemar(ended, reference),
        "causes": Counter(attempt.cause for attempt in ended.values() if not attempt.solved),
        "fallen": sum(attempt.fallen for attempt in ended.values()),
        "disturbed": sum(attempt.disturbed for attempt in ended.values()),
        # Counted without the names of their objects.
        "deviations": Counter(text.rpartition(": ")[2] for attempt in ended.values() for text in attempt.deviations),
        "sim_s": times([ended[k].sim_s for k in cleared]),
        "clearances": mean(list(cleared.values())),
        "duplicated": mean([ended[k].duplicated for k in cleared]),
        "ratio": mean([count / floors[k] for k, count in cleared.items() if floors.get(k)]),
        "at_floor": mean([float(count <= floors[k]) for k, count in cleared.items() if k in floors]),
        "replans": mean([attempt.replans for attempt in ended.values()]),
        "both": len(both),
        "difference": mean([cleared[k] - count for k, count in both.items()]),
        "shared": len(shared),
        "shared_floor": mean([floors[k] for k in shared]),
        "shared_clearances": mean([cleared[k] for k in shared]),
        "shared_duplicated": mean([ended[k].duplicated for k in shared]),
        "total": times([attempt.total_s for attempt in ended.values()]),
        "task": times([attempt.task_planning_s for attempt in ended.values()]),
        "motion": times([attempt.motion_planning_s for attempt in ended.values()]),
        "task_call": times([a.task_planning_s / a.task_plans for a in ended.values() if a.task_plans]),
    }


def mcnemar(own: Mapping[int, Record], reference: Mapping[int, Record]) -> float:
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


def markdown(summary: Summary, is_physics: bool) -> str:
    """All tables, one after another; in physics only the sum of the planning times of an episode is known."""
    rows, of_row = summary["rows"], {"N": "{objects}", "strategy": "{strategy}"}
    success, physics = {"success": "{success}"}, {}
    if is_physics:
        success = {"clean success": "{success}", "lifted": "{lifted}"}
        physics = {"fallen": "{fallen}", "disturbed": "{disturbed}", "deviations": "{deviated}"}
        physics |= {"simulated [s]": "{sim_s.median:.1f} ({sim_s.p95:.1f})"}
    planning = {} if is_physics else {"task planning": "task", "motion planning": "motion", "a task plan": "task_call"}
    planning = {"whole solve": "total", **planning}
    spent = [{**row, **{name: _milliseconds(row[name]) for name in planning.values()}} for row in rows]
    failed = [{**row, "why": _counts(row["causes"]), "deviated": _counts(row["deviations"])} for row in rows]
    scenes = [{**entry, "floor_time": _milliseconds(entry["floor_time"])} for entry in summary["scenes"]]
    first = rows[0]["strategy"] if rows else ""
    return "\n".join(
        (
            _section(
                "Table 1: objects cleared, and objects cleared twice or more",
                sorted([*rows, *_paper_rows({row["objects"] for row in rows})], key=lambda row: row["objects"]),
                {**of_row, "cleared": "{clearances}", "twice or more": "{duplicated.mean:.2f}"}
                | {"cleared / lower bound": "{ratio}", "exactly the lower bound": "{at_floor.mean:.0%}"}
                | {f"more than {first}": "{difference}", "both solved": "{both}"},
            ),
            _section(
                "Scenes that every strategy solves: objects cleared, and objects cleared twice or more",
                [row for row in rows if row["shared"]],
                {**of_row, "scenes": "{shared}", "lower bound": "{shared_floor.mean:.2f}"}
                | {"cleared": "{shared_clearances}", "twice or more": "{shared_duplicated.mean:.2f}"},
            ),
            _section(
                "Success, and causes of failure",
                failed,
                {**of_row, "solved": "{solved} / {scenes}", **success, "p": "{p_success:.2g}"}
                | {"replans": "{replans}", **physics, "causes of failure": "{why}", "crashed": "{crashed}"},
            ),
            _section(
                "Planning time [CPU ms]: median (95th percentile)",
                spent,
                of_row | {title: f"{{{name}}}" for title, name in planning.items()},
            ),
            _section(
                "Scenes",
                scenes,
                {"N": "{objects}", "resets": "{seeds}", "free": "{free}", "obstructed": "{obstructed}"}
                | {"no self-clearable set": "{without_set}", "unreachable": "{unreachable}", "crashed": "{crashed}"}
                | {"not proved": "{unproved}", "lower bound": "{floor}", "search [CPU ms]": "{floor_time}"},
            ),
        )
    )


def _paper_rows(objects: set[int]) -> list[Row]:
    """The rows of the paper with so many objects; its scenes are others."""
    nothing = {"ratio": NO_INTERVAL, "at_floor": NO_INTERVAL, "difference": NO_INTERVAL, "both": NOTHING}
    rows = []
    for index, count in enumerate(PAPER_OBJECTS):
        for name in PAPER["clearances"] if count in objects else ():
            cleared, twice = (PAPER[figure][name][index] for figure in ("clearances", "duplicated"))
            row = {"objects": count, "strategy": f"{name} in the paper", "clearances": cleared, **nothing}
            rows.append({**row, "duplicated": Interval(twice, twice, twice)})
    return rows


def _section(title: str, rows: Sequence[Row], columns: Mapping[str, str]) -> str:
    """A table with one line for each row; `columns` are formats by heading, NaN becomes a dash."""

    def cell(text: str, entry: Row) -> str:
        filled = text.format(**entry)
        return NOTHING if filled in ("nan", "nan%") else filled

    return markdown_section(title, list(columns), [[cell(text, entry) for text in columns.values()] for entry in rows])


def _counts(causes: Counter[str]) -> str:
    return ", ".join(f"{cause}: {count}" for cause, count in causes.most_common()) or "none"


def _milliseconds(value: Times) -> str:
    return number_text(value.median * 1e3, f"{{:.3g}} ({1e3 * value.p95:.3g})")


def write_page(trials: Trials, command: str, summary: Summary, page: Path) -> None:
    """Write the Markdown page, and its picture to images/ beside it."""
    picture = page.parent / "images" / f"{page.stem}.png"
    picture.parent.mkdir(parents=True, exist_ok=True)
    draw(summary).savefig(picture, dpi=130)
    arguments = trials.arguments
    kind = f'in physics, "{arguments.control_mode}" mode' if arguments.physics else "plans only"
    put = f" Objects may be put on: {' '.join(arguments.supports)}." if arguments.supports else ""
    which = ", whose target no level grasp reaches at once" if arguments.obstructed else ""
    page.write_text(
        f"# Clearance table ({kind})\n\n```sh\n{command}\n```\n\n"
        f"Robot {arguments.robot!r}, layout {arguments.layout!r}, grasp set {arguments.grasps!r}: plans and lower "
        f"bounds are for these grasps.{put} Each strategy is tried on the same scenes: resets of the environment, from "
        f"seed {arguments.seed} on{which}. Success rates have Wilson's 95% interval, all other means a 95% bootstrap "
        "interval over the scenes. The lower bound is the fewest objects that any plan must clear; *p* is of McNemar's "
        f"exact test that a strategy solves as many scenes as {next(iter(trials.variants))}.\n\n"
        f"![Clearance table]({picture.relative_to(page.parent)})\n\n{markdown(summary, arguments.physics)}"
    )


def draw(summary: Summary) -> Figure:
    """Success and planning time of all scenes; clearances and lower bound of those that every strategy solves."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.ticker import LogLocator

    figure = Figure(figsize=(11, 7.6), layout="constrained")
    success, clearances, duplicated, seconds = panels = figure.subplots(2, 2).ravel()
    objects = sorted({entry["objects"] for entry in summary["rows"]})
    strategies = list(dict.fromkeys(entry["strategy"] for entry in summary["rows"]))
    others = iter(OTHER_COLOURS)
    colours = {name: COLOURS.get(name) or next(others, "#777777") for name in strategies}
    for index, name in enumerate(strategies):
        rows = [entry for entry in summary["rows"] if entry["strategy"] == name]
        solve_times = [Interval(entry["total"].median, entry["total"].median, entry["total"].p95) for entry in rows]
        shift = _BESIDE * (index - (len(strategies) - 1) / 2)
        places = [objects.index(entry["objects"]) + shift for entry in rows]
        for axes, values in (
            (success, [entry["success"] for entry in rows]),
            (clearances, [entry["shared_clearances"] for entry in rows]),
            (duplicated, [entry["shared_duplicated"] for entry in rows]),
            (seconds, solve_times),
        ):
            mean, low, high = np.array(values).T
            reach, style = np.maximum([mean - low, high - mean], 0.0), {"markersize": 5, "elinewidth": 1.4}
            axes.errorbar(places, mean, reach, label=name, fmt="o", capsize=2.5, color=colours[name], **style)
    shared = {entry["objects"]: entry for entry in summary["rows"]}  # the same scenes for all strategies
    for at, number in enumerate(objects):
        ends, heights = [at - _FLOOR, at + _FLOOR], [shared[number]["shared_floor"].mean] * 2
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
    for axes in panels:
        counts = axes in (clearances, duplicated)
        labels = [f"{number}\nscenes: {shared[number]['shared']}" if counts else str(number) for number in objects]
        axes.set_xticks(range(len(labels)), labels)
        axes.set_xlabel("objects on the table")
        axes.grid(alpha=0.25, axis="y")
        axes.spines[["top", "right"]].set_visible(False)
    success.legend(loc="lower left", frameon=False)
    clearances.legend(handles=legend, loc="upper left", frameon=False, fontsize="small")
    return figure
