"""Make the suites of scenes: seeds, targets, lower bounds and digests, one JSON file for each suite.

    python scripts/make_suites.py --names side-15-v3 deep-15-v2

The files depend on the arguments `scenes` and `names` only. `--check` makes them again and compares them with those of
the package.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import tyro

import assets
from clutter_env.evaluation.suite_making import PLANS, file_text, make_suite
from clutter_env.reporting.files import write_atomically
from clutter_env.reporting.progress import progress_bar

NAMES = tuple(plan.name for plan in PLANS)


def main(
    names: tuple[str, ...] = NAMES,
    scenes: int = 100,
    workers: int = 2,
    check: bool = False,
    out: Path = Path("outputs/suites"),
) -> None:
    """Make and write, or compare, suite by suite.

    Args:
        names: Suites to make.
        scenes: Scenes in each split.
        workers: Number of processes.
        check: Write nothing; fail if a file of the package differs from what is made now.
        out: Directory of the files.
    """
    plans = {plan.name: plan for plan in PLANS}
    if unknown := [name for name in names if name not in plans]:
        sys.exit(f"no suite {unknown[0]!r}; suites: {', '.join(plans)}")
    for name in names:
        with progress_bar(total=2 * scenes, desc=name, unit="scene") as bar:
            text = file_text(make_suite(plans[name], scenes, workers, bar.update))
        if not check:
            out.mkdir(parents=True, exist_ok=True)
            write_atomically(out / f"{name}.json", text.encode())
            print(f"written: {out / name}.json")
        elif (packaged := assets.path(f"suites/{name}.json")).read_text() != text:
            found = _differences(json.loads(packaged.read_text()), json.loads(text))
            sys.exit("\n".join((f"{packaged} differs from what is made now", *found)))
        else:
            print(f"identical: {packaged}")


def _differences(there: dict[str, Any], now: dict[str, Any]) -> Iterator[str]:
    """A line for each scene that only one of two suites has, or that is another one in both."""
    for split, scenes in there["scenes"].items():
        old, new = ({entry["seed"]: entry for entry in entries} for entries in (scenes, now["scenes"][split]))
        for seed in sorted({*old, *new}):
            if seed not in new or seed not in old:
                yield f"{split}, seed {seed}: {'no longer qualifies' if seed in old else 'is new'}"
            elif old[seed] != new[seed]:
                parts = [part for part in old[seed] if old[seed][part] != new[seed][part]]
                yield f"{split}, seed {seed}: " + "; ".join(
                    f"{part} {old[seed][part]}, now {new[seed][part]}" for part in parts
                )


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
