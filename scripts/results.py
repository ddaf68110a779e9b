"""The results files of the repository, and the table and the picture that are made from them.

    python scripts/results.py run             # make all of them again, and say which actions have changed
    python scripts/results.py run side-15-v3_lookahead
    python scripts/results.py pages           # results/README.md and docs/images/results.png

A file holds every action of every episode, so that anybody confirms it with `clutter-env verify`. `run` plays a suite
with a policy, as `clutter-env evaluate` does, and writes the file; it takes some two minutes a row on two cores. A row
is added here, and nowhere else. The picture holds the digests of the files that it was drawn from, and a test compares
them.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tyro
from matplotlib.figure import Figure
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from clutter_env.cli.evaluate import Arguments as Evaluate, run as evaluate
from clutter_env.evaluation.evaluate import Evaluation
from clutter_env.evaluation.tables import Row, summarise
from clutter_env.evaluation.verify import claimed
from clutter_env.reporting.files import read_json, write_atomically
from clutter_env.reporting.tables import number_text
from clutter_env.suites import Floor, suite

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "results"
PICTURE = ROOT / "docs" / "images" / "results.png"
BOUNDS = RESULTS / "bounds.jsonl"
SOURCES = "sources"
"""Key of the picture's text that holds the digests of its files, as JSON."""


_COLOUR = "#1f6fb4"


class Result(NamedTuple):
    """A policy on the test scenes of a suite."""

    suite: str
    policy: str

    @property
    def name(self) -> str:
        """Of its file, without endings."""
        return f"{self.suite}_{self.policy}"

    @property
    def file(self) -> Path:
        """Where its results are."""
        return RESULTS / f"{self.name}.json.xz"


ROWS = (
    *(Result(name, "lookahead") for name in ("side-15-v3", "deep-15-v2", "deep-25-v2", "all-25-v3")),
    *(
        Result(name, "lookahead-all")
        for name in ("drawer-5-v1", "cupboard-5-v1", "fridge-10-v1", "blocked-drawer-5-v1")
    ),
    *(Result("side-15-v3", name) for name in ("keyframes", "end-to-end", "greedy")),
    *(Result("deep-15-v2", name) for name in ("keyframes", "end-to-end", "greedy")),
)
"""The results of the repository."""


@dataclass(frozen=True)
class Run:
    """Play again, and write the files."""

    names: tyro.conf.Positional[tuple[str, ...]] = ()
    """Of rows, as SUITE_POLICY; all if not given."""
    workers: int = 2
    """Number of processes."""


@dataclass(frozen=True)
class Pages:
    """Write the table and the picture."""


def run(arguments: Run) -> None:
    """Play each row, and say how many episodes have other actions than the file before.

    Raises:
        SystemExit: no row of that name.
    """
    known = {row.name: row for row in ROWS}
    if unknown := [name for name in arguments.names if name not in known]:
        raise SystemExit(f"no row {', '.join(unknown)}; known ones: {', '.join(known)}")
    for row in [known[name] for name in arguments.names] or ROWS:
        before = actions(row)
        evaluate(Evaluate(suite=row.suite, policy=row.policy, workers=arguments.workers, json=row.file))
        changed = sum(old != new for old, new in zip(before, actions(row), strict=True)) if before else "all"
        print(f"{row.name}: {changed} episodes with other actions than before\n")


def actions(row: Result) -> list[str]:
    """The digests of the actions of each episode, [] without a file."""
    return [episode["actions"] for episode in read_json(row.file)["episodes"]] if row.file.exists() else []


def pages(_arguments: Pages) -> None:
    """Write results/README.md and the picture."""
    bounds, known = bounds_of_today(), digests()
    rows = [(row, summarise(row.policy, [with_bounds(claimed(row.file), bounds)])) for row in ROWS]
    write_atomically(RESULTS / "README.md", table(rows, known).encode())
    draw([row for _, row in rows], known)


def bounds_of_today() -> dict[tuple[str, str, int], Floor]:
    """Lower bounds of `bounds.jsonl`, by suite, grasp set and seed."""
    lines = [json.loads(line) for line in BOUNDS.read_text().splitlines()]
    return {(row["suite"], row["grasps"], row["seed"]): Floor(row["today"], row["proved"]) for row in lines}


def with_bounds(evaluation: Evaluation, bounds: Mapping[tuple[str, str, int], Floor]) -> Evaluation:
    """The evaluation with the bounds of today, where they are known, in place of those of the suite's file."""
    name, grasps = evaluation.scenes.suite, evaluation.traits.grasps
    pairs = zip(evaluation.scores, evaluation.floors, strict=True)
    floors = [bounds.get((name, grasps, score.seed), floor) for score, floor in pairs]
    return replace(evaluation, floors=tuple(floors))


def table(rows: Sequence[tuple[Result, Row]], known: Mapping[str, str]) -> str:
    """The page of the files."""
    lines = [
        "# Results files",
        "",
        "Files of `clutter-env evaluate`, compressed, with every action of every episode. Anyone confirms them by "
        "playing the actions again:",
        "",
        "```sh",
        "clutter-env verify results/side-15-v3_lookahead.json.xz",
        "```",
        "",
        "| file | policy | scenes | clean | moved / lower bound | digest |",
        "|---|---|---|---|---|---|",
    ]
    for row, summary in rows:
        about, digest = suite(row.suite).about, known[row.file.name]
        clean, moved = summary.clean, summary.moved_per_floor
        lines.append(
            f"| `{row.file.name}` | `{row.policy}` | {summary.episodes}: {about} | "
            f"{clean.mean:.2f} [{clean.low:.2f}, {clean.high:.2f}] | {number_text(moved.mean)} | `{digest[:12]}` |"
        )
    lines += [
        "",
        "`make results` makes them again, and this page and the picture on the results page from them. "
        "[What a results file holds, and what it proves](../docs/verification.md).",
        "",
        "The lower bounds of the table are those of `bounds.jsonl`, for up to 40 base poses for each grasp "
        "(`python scripts/suite_bounds.py` finds them). It is the mean over clean episodes of scenes whose bound is 1 "
        "or more. Suites that the file lacks have the bounds of their own files, for three base poses. "
        "`clutter-env compare` shows the bounds of the suites' files, which are [often higher](../docs/audit.md"
        "#lower-bounds-that-have-changed).",
        "",
        "`cards.json` has the scores of the [task cards](../docs/environments/cards/index.md) that no other file has: "
        "`python -m scripts.card_scores` makes them again. `audits.json` has the small audits of the "
        "[suites](../docs/audit.md): `python -m scripts.audits`.",
        "",
    ]
    return "\n".join(lines)


def draw(rows: Sequence[Row], known: Mapping[str, str]) -> None:
    """Draw clean success and moves by the lower bound, and write the digests of the files into the picture."""
    figure = Figure(figsize=(9.0, 0.4 * len(rows) + 0.9), layout="constrained")
    success, moves = figure.subplots(1, 2, sharey=True, width_ratios=(1.4, 1.0))
    for axes, values in ((success, [row.clean for row in rows]), (moves, [row.moved_per_floor for row in rows])):
        for line, value in enumerate(values):
            error = np.maximum([[value.mean - value.low], [value.high - value.mean]], 0.0)
            axes.errorbar(value.mean, line, xerr=error, fmt="o", color=_COLOUR, markersize=5, capsize=3)
        axes.grid(axis="x", alpha=0.3)
        axes.tick_params(axis="y", length=0)
    success.set_yticks(range(len(rows)), [f"{row.scene_set}  {row.policy}" for row in rows])
    success.set_ylim(len(rows) - 0.5, -0.5)
    success.set(title="clean success of 100 scenes", xlim=(-0.03, 1.03))
    moves.set(title="moves / lower bound", xlim=(0.0, 1.8))
    moves.axvline(1.0, color="0.5", linewidth=1, linestyle=":")
    drawn, content, text = io.BytesIO(), io.BytesIO(), PngInfo()
    figure.savefig(drawn, dpi=120)
    text.add_text(SOURCES, json.dumps(dict(known)))
    Image.open(drawn).save(content, "PNG", pnginfo=text, optimize=True)
    write_atomically(PICTURE, content.getvalue())


def digests() -> dict[str, str]:
    """The digest of each file, and that of the bounds."""
    known = {row.file.name: read_json(row.file)["digest"] for row in ROWS}
    return {**known, BOUNDS.name: hashlib.sha256(BOUNDS.read_bytes()).hexdigest()}


if __name__ == "__main__":
    chosen = tyro.cli(Run | Pages)
    if isinstance(chosen, Run):
        run(chosen)
    else:
        pages(chosen)
