"""Small audits of all suites, kept in `results/audits.json`, and their table on docs/audit.md.

    python -m scripts.audits run                # of the suites that are not in the file yet
    python -m scripts.audits run side-15-v3     # again
    python -m scripts.audits table

Every audit is that of `clutter-env audit` with few scenes: enough to see whether a policy that does not look comes near
the expert, not to say how often it wins. A suite takes one to five minutes of CPU time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import tyro

from clutter_env.evaluation.audit import audit
from clutter_env.evaluation.audit_plan import AuditPlan
from clutter_env.provenance import provenance
from clutter_env.reporting.files import json_values, read_json, write_json
from clutter_env.reporting.tables import markdown_table
from clutter_env.suites import suite, suite_names

FILE = Path(__file__).resolve().parents[1] / "results" / "audits.json"
PLAN = AuditPlan(scenes=10, expert_scenes=0, demonstrations=3, workers=1)
"""None of ten scenes won: the rate is at most 0.28 (Wilson, 95%), so below 0.3 of an expert's that wins all."""
SEARCH_EXPERT = "examples.search_expert:Searches"
"""No named policy plays Search."""
HEAD = ["suite", "expert", "blind", "sees the robot", "sees all"]


@dataclass(frozen=True)
class Run:
    """Audit suites, and write the file after each."""

    names: tyro.conf.Positional[tuple[str, ...]] = ()
    """Of suites; if not given, those that are not in the file."""


@dataclass(frozen=True)
class Table:
    """Print the table."""


def run(arguments: Run) -> None:
    """Audit, and write what was found."""
    known = audits()
    for name in arguments.names or [name for name in suite_names() if name not in known]:
        plan = replace(PLAN, expert=SEARCH_EXPERT) if name.startswith("hidden") else PLAN
        found = json_values(audit(name, plan))
        known = {**audits(), name: {**found, "commit": provenance()["commit"], "suite_sha256": suite(name).digest}}
        write_json(FILE, known)
        print(row(known[name]), flush=True)


def audits() -> dict[str, Any]:
    """What was found of each suite."""
    return dict(read_json(FILE)) if FILE.exists() else {}


def table(known: Mapping[str, Any]) -> str:
    """The table of the page."""
    return markdown_table(HEAD, [row(known[name]) for name in sorted(known)])


def row(found: Mapping[str, Any]) -> Sequence[str]:
    """The line of a suite: the expert's rate in its demonstrations, and scenes won by the other policies."""
    expert = found["expert_clean"]
    won = [f"{round(one['clean']['mean'] * found['scenes'])}/{found['scenes']}" for one in found["played"]]
    return [f"`{found['suite']}`", f"{expert['mean']:.2f}", *won]


if __name__ == "__main__":
    chosen = tyro.cli(Run | Table)
    if isinstance(chosen, Run):
        run(chosen)
    else:
        print(table(audits()))
