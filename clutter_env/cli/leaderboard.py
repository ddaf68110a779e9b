"""A leaderboard of results files: a row for each policy, a column for each suite, every score confirmed by replay.

    clutter-env leaderboard outputs/evaluate/*.json

The recorded actions of each file are played again, as by `clutter-env verify`; what was found is kept in the output
directory, so that a file takes its time once. Files that are not confirmed are named below the table, without a score.
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

if TYPE_CHECKING:
    from clutter_env.reporting.intervals import Interval

WHEN_INTERRUPTED = "run the same command again to go on"


@dataclass(frozen=True)
class Arguments:
    """Make a leaderboard."""

    files: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Results files of `clutter-env evaluate`."""
    out: Path = Path("outputs/leaderboard")
    """Directory of leaderboard.md, leaderboard.html and verified.jsonl."""
    workers: int = 2
    """Number of processes."""
    json: Path | None = None
    """Write the entries to this file."""


@dataclass(frozen=True)
class Entry:
    """One results file, as its replay shows it.

    Attributes:
        file: the results file.
        policy, track, scenes: what it names, see `Verification`.
        clean: clean success.
        commands: that make such a file, where scenes are a suite's, and that confirm it.
        problem: why it is not confirmed, "" if it is.
    """

    file: Path
    policy: str
    track: str
    scenes: str
    clean: Interval
    commands: tuple[str, ...]
    problem: str


def run(arguments: Arguments) -> int:
    """Verify, tabulate, write; 1 if a file is not confirmed."""
    from clutter_env.errors import UsageError
    from clutter_env.reporting.files import write_atomically, write_json

    entries = _entries(arguments)
    places = [(entry.policy, entry.track, entry.scenes) for entry in entries if not entry.problem]
    if twice := next((place for place in places if places.count(place) > 1), None):
        raise UsageError(
            f"{' and '.join(str(e.file) for e in entries if (e.policy, e.track, e.scenes) == twice)} are "
            f"of one policy on the same scenes, {twice[2]}; give one of them"
        )
    arguments.out.mkdir(parents=True, exist_ok=True)
    # Text from a file cannot move the cursor of a terminal.
    text = "".join(sign if sign.isprintable() or sign == "\n" else "?" for sign in _markdown(entries))
    print(text)
    for name, page in (("leaderboard.md", text), ("leaderboard.html", _html(entries, arguments.out))):
        write_atomically(arguments.out / name, page.encode())
        print(f"written: {arguments.out / name}")
    if arguments.json is not None:
        write_json(arguments.json, entries)
    return 1 if any(entry.problem for entry in entries) else 0


def _entries(arguments: Arguments) -> list[Entry]:
    import hashlib
    import shlex

    from clutter_env.evaluation.verify import read_results, replay_seconds, scenes_of, verify
    from clutter_env.provenance import provenance
    from clutter_env.reporting.files import JsonLines, json_text
    from clutter_env.reporting.intervals import wilson
    from clutter_env.reporting.progress import progress_bar

    contents = [read_results(file) for file in arguments.files]  # all of them, before the first is played
    records = JsonLines(arguments.out / "verified.jsonl")
    known: dict[str, Any] = {line["key"]: line["found"] for line in records.values}
    entries, keys = [], []
    for file, content in zip(arguments.files, contents, strict=True):
        here = {**provenance(scenes_of(content).scenes[0].env_id), "commit": None}
        keys.append(hashlib.sha256(file.read_bytes() + json_text(here).encode()).hexdigest())
    new = [
        claim for key, content in zip(keys, contents, strict=True) if key not in known for claim in content["episodes"]
    ]
    with progress_bar(total=len(new), unit="episode", seconds=replay_seconds(new) / arguments.workers) as bar:
        for file, content, key in zip(arguments.files, contents, keys, strict=True):
            if key not in known:
                known[key] = asdict(verify(file, arguments.workers, bar.update))
                records.append({"key": key, "found": known[key]})
            found = known[key]
            commands: list[tuple[str, ...]] = [("clutter-env", "verify", str(file))]
            if content["suite"]:
                chosen = ("--suite", content["suite"], "--split", content["split"], "--policy", content["policy"])
                commands.insert(0, ("clutter-env", "evaluate", *chosen))
            problem = "".join(found["differences"][:1])
            if problem and found["other_than"]:
                problem += f" (not comparable: {found['other_than'][0]})"
            entries.append(
                Entry(
                    file,
                    found["policy"],
                    found["track"],
                    found["scenes"],
                    wilson(found["clean"], found["episodes"]),
                    tuple(map(shlex.join, commands)),
                    problem,
                )
            )
    return entries


def _table(entries: Sequence[Entry]) -> tuple[list[str], dict[tuple[str, str], list[Entry | None]]]:
    """Names of the scenes, and of each policy and track the entries on these scenes, the best policy first.

    Best is the highest mean success, where scenes that a policy has not played count 0.
    """
    good = [entry for entry in entries if not entry.problem]
    scenes = sorted({entry.scenes for entry in good})
    at = {(entry.policy, entry.track, entry.scenes): entry for entry in good}
    rows = {place[:2]: [at.get((*place[:2], name)) for name in scenes] for place in at}
    ranked = sorted(rows, key=lambda place: (-sum(entry.clean.mean for entry in rows[place] if entry), place))
    return scenes, {place: rows[place] for place in ranked}


def _markdown(entries: Sequence[Entry]) -> str:
    from clutter_env.reporting.tables import NOTHING, markdown_table

    scenes, rows = _table(entries)
    cells = [
        [*place, *(NOTHING if entry is None else str(entry.clean) for entry in row)] for place, row in rows.items()
    ]
    said = [f"- `{entry.file}`: `{entry.commands[0]}`\n" for entry in entries if not entry.problem]
    refused = [f"- `{entry.file}`: {entry.problem}\n" for entry in entries if entry.problem]
    parts = [
        f"# Leaderboard\n\n{_ABOUT}\n\n",
        markdown_table(["policy", "track", *scenes], cells),
        "\nConfirmed:\n\n",
        *said,
    ]
    return "".join([*parts, *(["\nNot confirmed:\n\n", *refused] if refused else [])])


def _html(entries: Sequence[Entry], out: Path) -> str:
    """One page without scripts and without anything from elsewhere; every score leads to its results file."""
    import os

    def link(entry: Entry | None) -> str:
        if entry is None:
            return "<td>–</td>"
        address = html.escape(Path(os.path.relpath(entry.file.absolute(), out.absolute())).as_posix())
        bar = f"background: linear-gradient(90deg, #cfe3f7 {entry.clean.mean:.0%}, transparent 0)"
        commands = html.escape("\n".join(entry.commands))
        return f'<td style="{bar}"><a href="{address}" title="{commands}">{entry.clean}</a></td>'

    scenes, rows = _table(entries)
    head = "".join(f"<th>{html.escape(name)}</th>" for name in ("policy", "track", *scenes))
    body = "".join(
        f"<tr>{''.join(f'<td>{html.escape(name)}</td>' for name in place)}{''.join(map(link, row))}</tr>\n"
        for place, row in rows.items()
    )
    commands = html.escape("\n".join(line for entry in entries if not entry.problem for line in entry.commands))
    refused = "".join(f"<li>{html.escape(f'{e.file}: {e.problem}')}</li>" for e in entries if e.problem)
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Leaderboard</title>'
        f"<style>{_STYLE}</style>\n<h1>Leaderboard</h1><p>{_ABOUT}</p>\n<table><tr>{head}</tr>\n{body}</table>\n"
        f"<h2>Commands</h2><pre>{commands}</pre>\n" + (f"<h2>Not confirmed</h2><ul>{refused}</ul>" if refused else "")
    )


_ABOUT = (
    "Clean success with 95% intervals (Wilson), confirmed by replay of the recorded actions. Which policy made them, "
    "and its track, are claims of the files."
)
_STYLE = (
    "body {font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 90rem; padding: 0 1rem; color: #222}"
    "table {border-collapse: collapse; display: block; overflow-x: auto} th, td {border-bottom: 1px solid #ddd;"
    " padding: .35rem .7rem; text-align: left; white-space: nowrap} a {color: inherit} pre {overflow-x: auto}"
)
