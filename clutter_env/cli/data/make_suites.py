"""Make the suites of scenes: seeds, targets, exact floors and digests, one JSON file for each suite.

    python scripts/make_suites.py --names side-15-v1 side-25-v1

The files depend on the arguments `scenes` and `names` only. `--check` makes them again and compares them with those of
the package. `--floors-only` keeps the scenes of these and computes their floors again, after a change of the planner.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import assets
from clutter_env.experiments.suites.making import PLANS, SuitePlan, make_suite, with_new_floors
from clutter_env.reporting.command import run_command
from clutter_env.reporting.files import json_text, write_atomically
from clutter_env.reporting.progress import progress_bar


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    names: tuple[str, ...] = tuple(plan.name for plan in PLANS)
    """Suites to make."""
    scenes: int = 100
    """Scenes in each split."""
    workers: int = 2
    """Number of processes."""
    check: bool = False
    """Write nothing; fail if a file of the package differs from what is made now."""
    floors_only: bool = False
    """Keep the scenes of the package's files and compute their floors again."""
    out: Path = Path("outputs/suites")
    """Directory of the files."""


def run(arguments: Arguments) -> None:
    """Make and write, or compare, suite by suite."""
    plans = {plan.name: plan for plan in PLANS}
    for name in arguments.names:
        if name not in plans:
            raise ValueError(f"no suite {name!r}; suites: {', '.join(plans)}")
    for name in arguments.names:
        packaged = assets.path(f"suites/{name}.json")
        text = _text(_content(plans[name], packaged, arguments))
        if not arguments.check:
            arguments.out.mkdir(parents=True, exist_ok=True)
            file = arguments.out / f"{name}.json"
            write_atomically(file, text.encode())
            print(f"written: {file}")
        elif packaged.read_text() != text:
            raise ValueError(f"{packaged} differs from what is made now")
        else:
            print(f"identical: {packaged}")


def _content(plan: SuitePlan, packaged: Path, arguments: Arguments) -> dict[str, Any]:
    """The content of a suite's file, as it is made now."""
    if not arguments.floors_only:
        with progress_bar(total=2 * arguments.scenes, desc=plan.name, unit="scene") as bar:
            return make_suite(plan, arguments.scenes, arguments.workers, bar.update)
    content = json.loads(packaged.read_text())
    with progress_bar(total=sum(map(len, content["scenes"].values())), desc=plan.name, unit="scene") as bar:
        return with_new_floors(content, arguments.workers, bar.update)


def _text(content: dict[str, Any]) -> str:
    """One scene a line."""
    scenes = {
        split: "[\n" + ",\n".join(json_text(entry) for entry in entries) + "\n]"
        for split, entries in content.pop("scenes").items()
    }
    head = json_text(content, indent=1).removesuffix("\n}")
    return head + ',\n "scenes": {' + ",\n".join(f'"{split}": {lines}' for split, lines in scenes.items()) + "}\n}\n"


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("make_suites", Arguments, run, __doc__, words)
