"""Make a leaderboard of results files: a row for each policy, a column for each suite, every score confirmed by replay.

    clutter-env leaderboard outputs/evaluate/*.json
    clutter-env leaderboard outputs/challenges/*_results.json outputs/evaluate/*.json --ledger outputs/challenges.jsonl

The recorded actions of each file are played again, as by `clutter-env verify`. The result is kept in the output
directory, so that each file is played only once. Unconfirmed files are named below the tables, without a score.

With a verifier's ledger the page has two tables. Results of its challenges whose policy is here, and gives the same
actions again, are measured, and rank. Of several under one name, the one that was played first ranks. All others are
claimed: scenes of public suites can be memorised, and nobody knows who made the actions of a file.
"""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeAlias

import tyro

if TYPE_CHECKING:
    from clutter_env.reporting.intervals import Interval

WHEN_INTERRUPTED = "run the same command again to go on"


@dataclass(frozen=True)
class Arguments:
    """Make a leaderboard."""

    files: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Results files of `clutter-env evaluate` and of `clutter-env challenge run`."""
    ledger: Path | None = None
    """The ledger of challenges that were drawn by whoever makes the leaderboard."""
    out: Path = Path("outputs/leaderboard")
    """Directory of leaderboard.md, leaderboard.html and verified.jsonl."""
    workers: int = 2
    """Number of processes."""
    json: Path | None = None
    """Write the entries to this file."""


class Entry(NamedTuple):
    """One results file, as its replay shows it. Policy, track and scenes are as in `Verification`.

    Attributes:
        clean: clean success.
        commands: to make such a file, for scenes of a suite, and to confirm it.
        problem: reason why it is not confirmed, "" if it is.
        is_measured: on fresh scenes that the maker of the leaderboard drew, by a policy that was run again.
    """

    file: Path
    policy: str
    track: str
    scenes: str
    clean: Interval
    commands: tuple[str, ...]
    problem: str
    is_measured: bool = False


Table: TypeAlias = tuple[list[str], list[list[str | Entry]]]
"""Its head, and a row for each policy: name, track, and the entry on each set of scenes, or a dash."""


def run(arguments: Arguments) -> int:
    """Verify the files and write the tables. Return 1 if a file is not confirmed.

    Policies are sorted by the lower ends of their intervals, on average over the sets of scenes, because a single
    successful scene is weaker evidence than 95 of a hundred. A set that a policy has not played is a 0.
    """
    from clutter_env.reporting.files import write_atomically, write_json

    entries = _entries(arguments)
    good = [entry for entry in entries if not entry.problem]
    measured, claimed = ([entry for entry in good if entry.is_measured is wanted] for wanted in (True, False))
    tables = (
        {"": _ranked(good)}
        if arguments.ledger is None
        else {"Measured": _ranked(measured), "Claimed": _ranked(claimed)}
    )
    arguments.out.mkdir(parents=True, exist_ok=True)
    # Text from a file cannot move the cursor of a terminal.
    text = "".join(sign if sign.isprintable() or sign == "\n" else "?" for sign in _markdown(tables, entries))
    print(text)
    for name, page in (("leaderboard.md", text), ("leaderboard.html", _html(tables, entries, arguments.out))):
        write_atomically(arguments.out / name, page.encode())
        print(f"written: {arguments.out / name}")
    if arguments.json is not None:
        write_json(arguments.json, entries)
    return 1 if len(good) < len(entries) else 0


def _ranked(entries: Sequence[Entry]) -> Table:
    """The table of some entries. Raise `UsageError` if two are of the same policy on the same scenes."""
    from clutter_env.errors import UsageError
    from clutter_env.reporting.tables import NOTHING

    at: dict[tuple[str, ...], Entry] = {}
    for entry in entries:
        place = (entry.policy, entry.track, entry.scenes)
        if (other := at.setdefault(place, entry)) is not entry:
            both = f"{other.file} and {entry.file}"
            raise UsageError(f"{both} are of one policy on the same scenes, {entry.scenes}; give one of them")
    head = ["policy", "track", *sorted({entry.scenes for entry in entries})]
    sums: dict[tuple[str, ...], float] = {}
    for of, entry in at.items():
        sums[of[:2]] = sums.get(of[:2], 0.0) + entry.clean.low
    ranked = sorted(sums, key=lambda policy: (-sums[policy], policy))
    return head, [[*policy, *(at.get((*policy, name), NOTHING) for name in head[2:])] for policy in ranked]


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
    played = zip(arguments.files, contents, keys, strict=True)
    new = [
        claim for key, content in zip(keys, contents, strict=True) if key not in known for claim in content["episodes"]
    ]
    with progress_bar(total=len(new), unit="episode", seconds=replay_seconds(new) / arguments.workers) as bar:
        for file, content, key in played:
            if key not in known:
                known[key] = asdict(verify(file, arguments.workers, bar.update))
                records.append({"key": key, "found": known[key]})
            found = known[key]
            commands = [shlex.join(("clutter-env", "verify", str(file)))]
            if content["suite"]:
                chosen = ("--suite", content["suite"], "--split", content["split"], "--policy", content["policy"])
                commands.insert(0, shlex.join(("clutter-env", "evaluate", *chosen)))
            problem = "".join(found["differences"][:1])
            if problem and found["other_than"]:
                problem += f" (not comparable: {found['other_than'][0]})"
            places, clean = (
                (found["policy"], found["track"], found["scenes"]),
                wilson(found["clean"], found["episodes"]),
            )
            entry = Entry(file, *places, clean, tuple(commands), problem)
            entries.append(_measured(entry, content["suite"], arguments))
    return entries


def _measured(entry: Entry, suite: str, arguments: Arguments) -> Entry:
    """The entry, marked as measured if it is of a challenge in the ledger and the challenge's check confirms it.

    Of all challenges under a policy's name only the one that was played first: nobody chooses the best of them.
    """
    from clutter_env.errors import LearningError
    from clutter_env.evaluation.challenge import Ledger, check, read_challenge
    from clutter_env.suites import FILE

    if entry.problem or arguments.ledger is None or not suite.endswith(FILE):
        return entry
    try:
        challenge = read_challenge(Path(suite))
    except LearningError:  # somebody's own file of scenes
        return entry
    if challenge.commitment != Ledger(arguments.ledger).first_started(challenge.entry.policy, challenge.entry.suite):
        return entry
    found = check(Path(suite), entry.file, arguments.ledger, workers=arguments.workers)
    if not found.is_measured:
        return entry
    return entry._replace(scenes=f"{challenge.entry.suite}, fresh", clean=found.clean, is_measured=True)


def _markdown(tables: Mapping[str, Table], entries: Sequence[Entry]) -> str:
    from clutter_env.reporting.tables import markdown_table

    shown = []
    for title, (head, cells) in tables.items():
        rows = [[str(cell.clean) if isinstance(cell, Entry) else cell for cell in row] for row in cells]
        shown.append(
            (title and f"## {title}\n\n{_OF[title]}\n\n") + (markdown_table(head, rows) if rows else "None.\n")
        )
    said = [f"- `{entry.file}`: `{entry.commands[0]}`\n" for entry in entries if not entry.problem]
    refused = [f"- `{entry.file}`: {entry.problem}\n" for entry in entries if entry.problem]
    parts = [f"# Leaderboard\n\n{_ABOUT}\n\n", "\n".join(shown), "\nConfirmed:\n\n", *said]
    return "".join([*parts, *(["\nNot confirmed:\n\n", *refused] if refused else [])])


def _html(tables: Mapping[str, Table], entries: Sequence[Entry], out: Path) -> str:
    """One page without scripts and external content. Every score links to its results file."""
    import os

    def tag(cell: str | Entry) -> str:
        if isinstance(cell, str):
            return f"<td>{html.escape(cell)}</td>"
        address = html.escape(Path(os.path.relpath(cell.file.absolute(), out.absolute())).as_posix())
        bar = f"background: linear-gradient(90deg, #cfe3f7 {cell.clean.mean:.0%}, transparent 0)"
        commands = html.escape("\n".join(cell.commands))
        return f'<td style="{bar}"><a href="{address}" title="{commands}">{cell.clean}</a></td>'

    shown = ""
    for title, (head, cells) in tables.items():
        titles = "".join(f"<th>{html.escape(name)}</th>" for name in head)
        body = "".join(f"<tr>{''.join(map(tag, row))}</tr>\n" for row in cells)
        shown += (title and f"<h2>{title}</h2><p>{_OF[title]}</p>") + f"<table><tr>{titles}</tr>\n{body}</table>\n"
    commands = html.escape("\n".join(line for entry in entries if not entry.problem for line in entry.commands))
    refused = "".join(f"<li>{html.escape(f'{e.file}: {e.problem}')}</li>" for e in entries if e.problem)
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Leaderboard</title>'
        f"<style>{_STYLE}</style>\n<h1>Leaderboard</h1><p>{_ABOUT}</p>\n{shown}"
        f"<h2>Commands</h2><pre>{commands}</pre>\n" + (f"<h2>Not confirmed</h2><ul>{refused}</ul>" if refused else "")
    )


_ABOUT = (
    "Clean success with 95% intervals (Wilson), confirmed by replay of the recorded actions; the lower ends of the "
    "intervals rank. Which policy made them, and its track, are claims of the files."
)
_OF = {
    "Measured": "Fresh scenes that the maker of this page drew after the policy's files were registered; every draw "
    "counts, and the policy gave the same actions when it was run again. Of several challenges under one name the one "
    "that was played first.",
    "Claimed": "Public scenes, which a policy may know by heart, and scenes that the entrant drew.",
}
_STYLE = (
    "body {font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 90rem; padding: 0 1rem; color: #222}"
    "table {border-collapse: collapse; display: block; overflow-x: auto} th, td {border-bottom: 1px solid #ddd;"
    " padding: .35rem .7rem; text-align: left; white-space: nowrap} a {color: inherit} pre {overflow-x: auto}"
)
