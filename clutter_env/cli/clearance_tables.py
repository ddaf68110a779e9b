"""Figures of a clearance table, paired by scene and with 95% intervals, and its Markdown tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from clutter_env.cli.clearance_trials import CRASH, Record, Trials
from clutter_env.reporting.intervals import NO_INTERVAL, Interval, Times, bootstrap, times, wilson
from clutter_env.reporting.tables import NOTHING, markdown_table, number_text

Row: TypeAlias = dict[str, Any]
Summary: TypeAlias = dict[str, list[Row]]

PAPER_OBJECTS = (15, 20, 25, 30, 35, 40)
PAPER = {
    "clearances": {"srivastava": (3.4, 6.6, 7.5, 8.2, 10.7, 11.2), "ngr": (3.0, 5.0, 5.0, 6.0, 6.0, 6.0)},
    "duplicated": {"srivastava": (0.3, 0.7, 1.2, 1.6, 2.3, 3.0), "ngr": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)},
}
"""Table 1 of Lee & Kim 2019: objects cleared, and objects cleared twice or more, for `PAPER_OBJECTS`."""


def summarise(trials: Trials) -> Summary:
    """The figures of the available trials.

    Returns:
        "scenes": one entry for each number of objects. "rows": one for each number of objects and each strategy.
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
    """Numbers of assessed scenes, by their lower bounds.

    A scene is obstructed if something has to be cleared before a level gripper takes the target, whatever the grasps of
    the table. `seed` is of the bootstrap.
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
    """The figures of every strategy. Attempts that crashed are included only in "crashed".

    Figures whose names begin with "both" are over the scenes that both the strategy and the first strategy solved.
    Those with "shared" are over the scenes that all strategies solved and whose lower bound is proved.

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

    The test is binomial over the scenes that only one of the two solves. NaN if no scene was tried by both.
    """
    from scipy.stats import binomtest

    both = [(own[k].solved, reference[k].solved) for k in own if k in reference and reference[k].cause != CRASH]
    only_own = sum(mine and not theirs for mine, theirs in both)
    only_reference = sum(theirs and not mine for mine, theirs in both)
    if not only_own + only_reference:
        return 1.0 if both else np.nan
    return float(binomtest(only_own, only_own + only_reference).pvalue)


def markdown(summary: Summary, is_physics: bool) -> str:
    """All tables, one after another. In physics only the sum of an episode's planning times is known."""
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
    """The paper's rows with this number of objects. Its scenes are others."""
    nothing = {"ratio": NO_INTERVAL, "at_floor": NO_INTERVAL, "difference": NO_INTERVAL, "both": NOTHING}
    rows = []
    for index, count in enumerate(PAPER_OBJECTS):
        for name in PAPER["clearances"] if count in objects else ():
            cleared, twice = (PAPER[figure][name][index] for figure in ("clearances", "duplicated"))
            row = {"objects": count, "strategy": f"{name} in the paper", "clearances": cleared, **nothing}
            rows.append({**row, "duplicated": Interval(twice, twice, twice)})
    return rows


def _section(title: str, rows: Sequence[Row], columns: Mapping[str, str]) -> str:
    """A table with one line for each row. `columns` are formats by heading, NaN becomes a dash."""

    def cell(text: str, entry: Row) -> str:
        filled = text.format(**entry)
        return NOTHING if filled in ("nan", "nan%") else filled

    cells = [[cell(text, entry) for text in columns.values()] for entry in rows]
    return f"### {title}\n\n{markdown_table(list(columns), cells)}"


def _counts(causes: Counter[str]) -> str:
    return ", ".join(f"{cause}: {count}" for cause, count in causes.most_common()) or "none"


def _milliseconds(value: Times) -> str:
    return number_text(value.median * 1e3, f"{{:.3g}} ({1e3 * value.p95:.3g})")
