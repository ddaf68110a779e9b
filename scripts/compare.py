"""Compare expert strategies, baselines and trained policies on the same held-out scenes.

    python scripts/compare.py --envs clutter_env/Retrieve-o5-v0 clutter_env/Retrieve-o10-v0 \\
        --contenders lookahead random greedy --runs outputs/runs/maskable_ppo-skill-* --scenes 50

Runs of one algorithm that differ in their seed form one row. A Markdown table, all scores as JSON and a plot over the
number of objects are written to the output directory; scores that are there already are not made again.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tyro
from tqdm import tqdm

from learning.baselines import BASELINES
from learning.dataset import write_json
from learning.errors import CollectionError, LearningError
from learning.evaluation import Score, held_out_seeds
from learning.experts import expert_names
from learning.matches import Match, arena_name, contender_name, play_match, run_environment
from learning.runs import RUN_FILE, load_run
from learning.tables import Row, markdown, plot, summarise
from learning.workers import LocalWorkers, RayWorkers, WorkerDied, Workers

Result = Score | int | None


@dataclass(frozen=True)
class Arguments:
    """Compare contenders."""

    envs: tuple[str, ...] = ("clutter_env/Retrieve-o5-v0",)
    """Environments; Skill contenders play the scenes of the Retrieve environment with as many objects."""
    contenders: tuple[str, ...] = ("lookahead", "random", "greedy")
    """Strategies of the planner, scripts, "random", "greedy"."""
    runs: tuple[Path, ...] = ()
    """Directories of train.py; each plays the environments whose scenes it was trained on."""
    scenes: int = 50
    """Held-out scenes."""
    max_steps: int = 1500
    """Steps of 0.05 s after which an episode of low-level actions is cut off."""
    workers: int = 2
    """Processes."""
    ray: str = ""
    """Ray's address ("auto", "local", …): play there instead of in processes of this machine."""
    seed: int = 0
    """Of the bootstrap."""
    out: Path = Path("outputs/compare")
    """Directory of table.md, plot.png and scores.json."""
    json: Path | None = None
    """Write the rows to this file."""


def main(arguments: Arguments) -> None:
    """Play, summarise, print."""
    matches = make_matches(arguments)
    arguments.out.mkdir(parents=True, exist_ok=True)
    results = play_all(arguments, matches)
    rows = make_rows(arguments, results)
    table = markdown(rows)
    command = "python scripts/compare.py " + " ".join(sys.argv[1:])
    (arguments.out / "table.md").write_text(f"`{command}`\n\n{table}")
    plot(rows, arguments.out / "plot.png")
    print(table)
    if arguments.json is not None:
        write_json(arguments.json, [asdict(row) for row in rows])


def make_matches(arguments: Arguments) -> list[Match]:
    """Every contender on every scene that it can play."""
    matches = []
    for env_id in arguments.envs:
        known = (*expert_names(env_id), *BASELINES)
        for name in arguments.contenders:
            if name not in known:
                raise LearningError(f"no contender {name!r} for {env_id}; known ones: {', '.join(known)}, and runs")
        runs = [str(run) for run in arguments.runs if arena_name(run_environment(run)) == arena_name(env_id)]
        floors = ("floor",) if "/Retrieve" in env_id else ()
        for contender in (*floors, *arguments.contenders, *runs):
            matches += [
                Match(env_id, contender, seed, arguments.max_steps) for seed in held_out_seeds(arguments.scenes)
            ]
    return matches


def play_all(arguments: Arguments, matches: list[Match]) -> dict[Match, Result]:
    """The results of all matches, those in scores.json included."""
    path = arguments.out / "scores.json"
    known = json.loads(path.read_text()) if path.exists() else {}
    missing = [match for match in matches if key(match) not in known]
    for index, result in tqdm(played(arguments, missing), total=len(missing), unit="match"):
        known[key(missing[index])] = asdict(result) if isinstance(result, Score) else result
        write_json(path, known)
    return {match: restored(known[key(match)]) for match in matches}


def played(arguments: Arguments, matches: list[Match]) -> Iterator[tuple[int, Result]]:
    """Pairs of index and result, as they come."""
    if not matches:
        return
    workers: Workers[Result]
    if arguments.ray:
        workers = RayWorkers(play_match, matches, arguments.workers, arguments.ray)
    else:
        workers = LocalWorkers(play_match, matches, arguments.workers)
    waiting = list(reversed(range(len(matches))))
    running = 0
    try:
        while waiting or running:
            while waiting and running < workers.count:
                workers.submit(waiting.pop())
                running += 1
            for index, result in workers.wait():
                running -= 1
                if isinstance(result, WorkerDied):
                    raise CollectionError(f"{matches[index]}: {result.cause}")
                yield index, result
    finally:
        workers.close()


def make_rows(arguments: Arguments, results: dict[Match, Result]) -> list[Row]:
    """One row per environment and contender."""
    rows = []
    for env_id in arguments.envs:
        own = {match: result for match, result in results.items() if match.env_id == env_id}
        floors = {m.seed: r for m, r in own.items() if m.contender == "floor" and not isinstance(r, Score)}
        groups: dict[str, dict[str, list[Score]]] = {}
        for match, result in own.items():
            if isinstance(result, Score):
                runs = groups.setdefault(contender_name(match.contender), {})
                runs.setdefault(match.contender, []).append(result)
        for name, by_run in groups.items():
            rows.append(summarise(arena_name(env_id), name, list(by_run.values()), floors, arguments.seed))
    return rows


def key(match: Match) -> str:
    """Identifies a match in scores.json; a run that was trained further plays anew."""
    is_run = (Path(match.contender) / RUN_FILE).exists()
    steps = f" after {load_run(Path(match.contender))['steps']}" if is_run else ""
    return f"{match.env_id} {match.contender}{steps} {match.seed} {match.max_steps}"


def restored(value: dict[str, Any] | int | None) -> Result:
    """A result read back from JSON."""
    return Score(**value) if isinstance(value, dict) else value


if __name__ == "__main__":
    try:
        main(tyro.cli(Arguments, description=__doc__))
    except LearningError as problem:
        sys.exit(f"compare: {problem}")
