"""Rows of `lookahead` without one of its parts, or with two arms, beside those of `clutter-env table`.

    python scripts/ablations.py --objects 15 40 --scenes 20
    python scripts/ablations.py --arms --robot pr2 --strategies lookahead --objects 15 25 --scenes 30 --time-limit 60

All arguments of `clutter-env table` are known.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from assets import robot as find_robot
from clutter_env.cli import table, table_arguments
from clutter_env.cli.clearance_trials import Record, Trials, Variant
from clutter_env.reporting.intervals import bootstrap
from clutter_env.reporting.tables import markdown_table, number_text
from clutter_env.scene.layout import TABLE
from planners import STRATEGIES

LOOKAHEAD = STRATEGIES["lookahead"]
ABLATIONS = {
    # The smallest set is still chosen, but clearances are not simulated before the first motion.
    "lookahead - look-ahead": Variant(
        replace(LOOKAHEAD, plans_ahead=False, sets=1, slack=0, variations=0, non_monotone=0)
    ),
    "lookahead - tilt": Variant(LOOKAHEAD, {"grasps": "side"}),
    "lookahead - counters": Variant(LOOKAHEAD, {"supports": (TABLE,)}),
    "lookahead - second moves": Variant(replace(LOOKAHEAD, non_monotone=0)),
}
ARMS = {
    "lookahead, one arm, less time": Variant(LOOKAHEAD, {"saves_time": True}),
    "lookahead, two arms": Variant(LOOKAHEAD, all_arms=True),
    "lookahead, two arms, hold aside": Variant(LOOKAHEAD, {"hold_aside": True}, all_arms=True),
}


@dataclass(frozen=True)
class Arguments(table_arguments.Arguments):
    """Those of `clutter-env table`, and which rows are added."""

    arms: bool = False
    """Add rows with two arms instead: for a robot with two."""
    out: Path = Path("outputs/ablations")
    """Directory of trials.jsonl, table.json and table.md."""


def main(arguments: tyro.conf.OmitArgPrefixes[Arguments]) -> None:
    """Make the table; for arms, also of base motions and simulated time."""
    variants = dict(ARMS if arguments.arms else ABLATIONS)
    if arguments.arms and not find_robot(arguments.robot).idle_arms:
        sys.exit(f"--robot {arguments.robot} has one arm; to compare one arm with two take --robot pr2")
    if not arguments.supports and arguments.grasps != "side":
        # A level gripper alone still puts objects where the other grasps would.
        variants["lookahead - tilt"] = Variant(LOOKAHEAD, {"grasps": "side", "supports": "all"})
    table.run(arguments, variants, "python scripts/ablations.py")
    if arguments.arms:
        print(effort(arguments, variants))


def effort(arguments: Arguments, variants: Mapping[str, Variant]) -> str:
    """Base motions and simulated time of a plan, paired with the first strategy."""
    reference = arguments.strategies[0]
    trials = Trials(arguments, variants)
    head = ["N", "planner", "base motions", reference, "fewer", "simulated time [s]", reference, "less [s]"]
    lines = []
    for objects in arguments.objects:
        attempts = {name: trials.attempts(objects, name) for name in (reference, *variants)}
        for name, own in attempts.items():
            lines.append([str(objects), name, *paired(own, attempts[reference])])
    return f"### Base motions and simulated time, paired with {reference}\n\n{markdown_table(head, lines)}"


def paired(own: Mapping[int, Record], reference: Mapping[int, Record]) -> list[str]:
    """Means over the scenes that both solved, of base motions and simulated time: own, the reference's, difference."""
    both = [(one, reference[k]) for k, one in own.items() if one.solved and k in reference and reference[k].solved]
    cells = []
    for name in ("base_moves", "sim_s"):
        values = np.array([(getattr(one, name), getattr(other, name)) for one, other in both], float).reshape(-1, 2)
        means = values.mean(axis=0) if len(both) else np.full(2, np.nan)
        less = bootstrap([(values[:, 1] - values[:, 0]).tolist()], np.random.default_rng(0))
        cells += [*map(number_text, means), str(less)]
    return cells


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
