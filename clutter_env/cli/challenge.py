"""Measure a policy on fresh scenes that neither its author nor anybody else could choose.

    clutter-env challenge new --policy my_module:MyPolicy --suite side-15-v3 --out mine.json
    clutter-env challenge run mine.json --json mine_results.json
    clutter-env challenge check mine.json mine_results.json

Whoever verifies runs these commands, with a ledger of his own. `new` writes the digest of the policy's files into it,
then draws a nonce, from which the scenes follow by the suite's rules. `run` plays them, once. `check` draws the scenes
again, replays the actions, and runs the policy again on ten scenes. Every draw in the ledger counts. See
docs/verification.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeAlias

import tyro


@dataclass(frozen=True)
class New:
    """Register a policy, and draw scenes for it."""

    policy: str
    """A name as for `clutter-env evaluate`."""
    suite: str = "side-15-v3"
    """The suite whose kind of scenes it is."""
    scenes: int = 100
    """Number of scenes."""
    files: tuple[Path, ...] = ()
    """More files that the policy is made of: modules that its module imports, weights."""
    uses_planner: bool = False
    """Declare that the policy imports the package's planner."""
    ledger: Path = Path("outputs/challenges.jsonl")
    """The verifier's file of everything that was drawn."""
    out: Path | None = None
    """The challenge's file. outputs/challenges/POLICY_SUITE_NUMBER.json if not given."""
    workers: int = 2
    """Number of processes."""


@dataclass(frozen=True)
class Run:
    """Play a challenge, once."""

    file: Annotated[Path, tyro.conf.Positional]
    """The challenge's file."""
    files: tuple[Path, ...] = ()
    """As of `new`."""
    ledger: Path = Path("outputs/challenges.jsonl")
    """The verifier's file of everything that was drawn."""
    json: Path | None = None
    """The results file. By default in the challenge's directory, with "_results" in its name."""
    count_crashes: bool = False
    """Count an exception of the policy as a failed episode. Otherwise it ends the run."""
    trust: bool = False
    """Load models of Stable-Baselines3 (ALGORITHM:FILE.zip), which executes code that is in the file."""
    python: str = ""
    """For lerobot:DIRECTORY: the interpreter of an environment in which LeRobot is installed."""
    workers: int = 2
    """Number of processes."""


@dataclass(frozen=True)
class Check:
    """Confirm the results of a challenge."""

    file: Annotated[Path, tyro.conf.Positional]
    """The challenge's file."""
    results: Annotated[Path, tyro.conf.Positional]
    """Its results file."""
    again: int = 10
    """Scenes that the policy plays again. Use 0 if the policy is not here. Then nothing is measured."""
    ledger: Path = Path("outputs/challenges.jsonl")
    """The verifier's file of everything that was drawn."""
    trust: bool = False
    """Load models of Stable-Baselines3 (ALGORITHM:FILE.zip), which executes code that is in the file."""
    python: str = ""
    """For lerobot:DIRECTORY: the interpreter of an environment in which LeRobot is installed."""
    workers: int = 2
    """Number of processes."""


Arguments: TypeAlias = New | Run | Check


def run(arguments: Arguments) -> int:
    """Run the chosen subcommand. Return 1 if a check does not confirm the results."""
    if isinstance(arguments, New):
        return _new(arguments)
    return _play(arguments) if isinstance(arguments, Run) else _check(arguments)


def _new(arguments: New) -> int:
    from clutter_env.evaluation.challenge import Ledger, new_challenge, register
    from clutter_env.reporting.progress import progress_bar

    entry = register(
        arguments.policy, arguments.suite, arguments.scenes, arguments.files, uses_planner=arguments.uses_planner
    )
    number = len(Ledger(arguments.ledger).draws(entry.digest)) + 1
    name = f"{arguments.policy}_{arguments.suite}_{number}".replace(":", ".").replace("/", ".")
    file = arguments.out or Path("outputs/challenges") / f"{name}.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    with progress_bar(total=arguments.scenes, unit="scene") as bar:
        challenge = new_challenge(entry, arguments.ledger, file, arguments.workers, bar.update)
    print(f"entry {entry.digest[:16]} of {len(entry.files)} files, draw {number} of it: {arguments.ledger}")
    print(f"the nonce has SHA-256 {challenge.commitment}, and stands in the challenge's file")
    print(f"written: {file}; keep it to yourself until it has been played")
    return 0


def _play(arguments: Run) -> int:
    from clutter_env.evaluation.challenge import play, read_challenge
    from clutter_env.evaluation.evaluate import EPISODE_S
    from clutter_env.evaluation.tables import markdown, results, summarise
    from clutter_env.reporting.files import write_json
    from clutter_env.reporting.progress import progress_bar

    entry = read_challenge(arguments.file).entry
    names = ("trust", "python", "workers", "count_crashes")
    chosen = {name: getattr(arguments, name) for name in names}
    seconds = EPISODE_S * entry.scenes / arguments.workers
    with progress_bar(total=entry.scenes, unit="episode", seconds=seconds) as bar:
        evaluation = play(arguments.file, arguments.ledger, arguments.files, tick=bar.update, **chosen)
    print(markdown([summarise(entry.policy, [evaluation])]))
    file = arguments.json or arguments.file.with_name(f"{arguments.file.stem}_results.json")
    write_json(file, results(evaluation))
    print(f"written: {file}")
    return 0


def _check(arguments: Check) -> int:
    from clutter_env.evaluation.challenge import check
    from clutter_env.evaluation.verify import read_results, replay_seconds
    from clutter_env.reporting.progress import progress_bar

    claims = read_results(arguments.results)["episodes"]
    chosen = {name: getattr(arguments, name) for name in ("trust", "python", "workers")}
    with progress_bar(total=len(claims), unit="episode", seconds=replay_seconds(claims) / arguments.workers) as bar:
        found = check(arguments.file, arguments.results, arguments.ledger, arguments.again, tick=bar.update, **chosen)
    entry = found.challenge.entry
    print("measured" if found.is_measured else "NOT measured", f"{entry.policy} on {entry.suite}: clean {found.clean}")
    lines = [*found.problems, *found.replay.differences]
    if found.same is None:
        lines.append("the policy was not run again")
    else:
        lines.append(f"the policy was run again on {found.again} scenes, with the same actions in {found.same}")
    abandoned = found.draws - 1
    lines.append(f"draws of this entry: {found.draws}" + (f"; {abandoned} count as failures" if abandoned > 0 else ""))
    if found.starts > 1:
        lines.append(f"runs of this draw that were begun: {found.starts}, of which one reached its last scene")
    lines.append(f"entries of this name before it: {found.earlier}")
    print(*lines, sep="\n  ")
    return 0 if found.is_measured else 1
