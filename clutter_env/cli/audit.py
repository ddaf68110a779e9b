"""Audit a suite: scores of policies that do not look, and significant differences between results.

    clutter-env audit drawer-5-v1 --scenes 30 --demonstrations 30
    clutter-env audit side-15-v3 --network --suites 3
    clutter-env audit --files results/*.json.xz

The expert plays the first scenes of the test split, and demonstrates on the validation split. A blind policy plays one
of the demonstrated sequences of actions, whatever it sees. Another policy sees the robot alone. A third plays the
demonstration whose first observation is nearest. With --files: number of pairs of results files of the same scenes
that differ significantly. See docs/audit.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from clutter_env.evaluation.audit_plan import AuditPlan

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clutter_env.evaluation.audit import Audit
    from clutter_env.evaluation.paired import Pair


@dataclass(frozen=True)
class Arguments(AuditPlan):
    """Audit a suite."""

    suites_of: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(name="suite")] = ()
    """Names of suites."""
    files: tuple[Path, ...] = ()
    """Results files, whose differences are tested in pairs."""
    json: Path | None = None
    """Write what was found to this file."""


def run(arguments: Arguments) -> int:
    """Play and print. Return 1 if a blind policy reaches 0.3 of the expert's score in any suite."""
    from clutter_env.errors import UsageError
    from clutter_env.evaluation.audit import audit, episodes_of
    from clutter_env.evaluation.evaluate import EPISODE_S
    from clutter_env.evaluation.paired import pairs_of
    from clutter_env.evaluation.verify import read_results
    from clutter_env.reporting.files import write_json
    from clutter_env.reporting.progress import progress_bar

    if not arguments.suites_of and not arguments.files:
        raise UsageError("name a suite, or --files")
    found = []
    for suite in arguments.suites_of:
        count = episodes_of(arguments)
        with progress_bar(total=count, unit="episode", seconds=EPISODE_S * count / arguments.workers) as bar:
            found.append(audit(suite, arguments, bar.update))
        print(_text(found[-1]))
    pairs = pairs_of([read_results(file) for file in arguments.files])
    if arguments.files:
        print(_pairs_text(pairs))
    if arguments.json is not None:
        write_json(arguments.json, {"audits": found, "pairs": pairs})
    return 1 if any(one.is_blind for one in found) else 0


def _text(found: Audit) -> str:
    from clutter_env.evaluation.audit import BLIND_SHARE
    from clutter_env.reporting.tables import markdown_table

    rows = [[one.policy, str(one.clean), f"{one.share:.2f}"] for one in found.played]
    head = ["policy", "clean success", "share of the expert's"]
    lines = [
        f"## {found.suite}: {found.scenes} scenes, {found.demonstrations} demonstrations\n",
        markdown_table(head, [[f"expert ({found.expert})", str(found.expert_clean), "1.00"], *rows]),
    ]
    if found.spread is not None:
        rates = ", ".join(f"{rate:.2f}" for rate in found.spread.rates)
        lines.append(
            f"Other suites by the same rules, {found.spread.scenes} scenes each, {found.spread.policy}: {rates}; "
            f"range {found.spread.range:.2f}."
        )
    if found.fewest_won is None:
        lines.append(f"No difference on {found.scenes} scenes is significant.")
    else:
        shown = "nothing" if found.shown is None else f"{found.shown:.2f}"
        lines.append(
            f"Significant: {found.fewest_won} scenes more and none less; below the expert, a true difference of "
            f"{shown} is shown in 80% of comparisons."
        )
    if found.is_blind:
        lines.append(f"A POLICY THAT DOES NOT SEE THE SCENE REACHES {BLIND_SHARE} OF THE EXPERT'S SCORE.")
    return "\n".join(lines) + "\n"


def _pairs_text(pairs: Sequence[Pair]) -> str:
    from clutter_env.reporting.tables import markdown_table

    head = ["scenes", "policies", "clean success", "p (McNemar, exact)"]
    rows = [
        [
            f"{one.scenes}, {one.count}",
            " / ".join(one.policies),
            f"{one.clean[0]:.2f} / {one.clean[1]:.2f}",
            f"{one.p_value:.2g}",
        ]
        for one in pairs
    ]
    differing = [one for one in pairs if one.is_difference]
    share = sum(one.is_significant for one in differing)
    said = f"{share} of {len(differing)} differences between two policies on the same scenes are significant."
    return (markdown_table(head, rows) + "\n" if rows else "") + said + "\n"
