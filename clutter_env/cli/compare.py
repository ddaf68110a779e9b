"""Compare expert strategies, baselines and trained policies on the same held-out scenes.

    python scripts/compare.py --envs clutter_env/Retrieve-o5-v0 clutter_env/Retrieve-o10-v0 \\
        --policies lookahead random greedy --runs outputs/runs/maskable_ppo-skill-* --scenes 50

Runs of one algorithm that differ in their seed form one row. A Markdown table, all scores as JSON and a plot over the
number of objects are written to the output directory; scores that are there already are not made again.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from clutter_env.cli.command import run_command
from clutter_env.learning.comparison.evaluation import Score, held_out_seeds
from clutter_env.learning.comparison.jobs import EvaluationJob, policy_name, run_environment, run_job, scene_set_name
from clutter_env.learning.comparison.tables import Row, markdown, plot, summarise
from clutter_env.learning.demonstrations.dataset import write_json
from clutter_env.learning.demonstrations.experts import expert_names
from clutter_env.learning.errors import CollectionError, LearningError
from clutter_env.learning.policies.baselines import BASELINES
from clutter_env.learning.policies.runs import RUN_FILE, load_run
from clutter_env.parallel.workers import LocalWorkers, RayWorkers, WorkerDied, Workers

Result = Score | int | None


@dataclass(frozen=True)
class Arguments:
    """Compare policies."""

    envs: tuple[str, ...] = ("clutter_env/Retrieve-o5-v0",)
    """Environments; Skill policies play the scenes of the Retrieve environment with as many objects."""
    policies: tuple[str, ...] = ("lookahead", "random", "greedy")
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


def run(arguments: Arguments) -> None:
    """Play, summarise, print."""
    jobs = make_jobs(arguments)
    arguments.out.mkdir(parents=True, exist_ok=True)
    results = play_all(arguments, jobs)
    rows = make_rows(arguments, results)
    table = markdown(rows)
    command = "python scripts/compare.py " + " ".join(sys.argv[1:])
    (arguments.out / "table.md").write_text(f"`{command}`\n\n{table}")
    plot(rows, arguments.out / "plot.png")
    print(table)
    if arguments.json is not None:
        write_json(arguments.json, [asdict(row) for row in rows])


def make_jobs(arguments: Arguments) -> list[EvaluationJob]:
    """Every policy on every scene that it can play."""
    jobs = []
    for env_id in arguments.envs:
        known = (*expert_names(env_id), *BASELINES)
        for name in arguments.policies:
            if name not in known:
                raise LearningError(f"no policy {name!r} for {env_id}; known ones: {', '.join(known)}, and runs")
        runs = [str(run) for run in arguments.runs if scene_set_name(run_environment(run)) == scene_set_name(env_id)]
        floors = ("floor",) if "/Retrieve" in env_id else ()
        for policy in (*floors, *arguments.policies, *runs):
            jobs += [
                EvaluationJob(env_id, policy, seed, arguments.max_steps) for seed in held_out_seeds(arguments.scenes)
            ]
    return jobs


def play_all(arguments: Arguments, jobs: list[EvaluationJob]) -> dict[EvaluationJob, Result]:
    """The results of all jobs, those in scores.json included."""
    path = arguments.out / "scores.json"
    known = json.loads(path.read_text()) if path.exists() else {}
    missing = [job for job in jobs if key(job) not in known]
    for index, result in tqdm(played(arguments, missing), total=len(missing), unit="match"):
        known[key(missing[index])] = asdict(result) if isinstance(result, Score) else result
        write_json(path, known)
    return {job: restored(known[key(job)]) for job in jobs}


def played(arguments: Arguments, jobs: list[EvaluationJob]) -> Iterator[tuple[int, Result]]:
    """Pairs of index and result, as they come."""
    if not jobs:
        return
    workers: Workers[Result]
    if arguments.ray:
        workers = RayWorkers(run_job, jobs, arguments.workers, arguments.ray)
    else:
        workers = LocalWorkers(run_job, jobs, arguments.workers)
    waiting = list(reversed(range(len(jobs))))
    running = 0
    try:
        while waiting or running:
            while waiting and running < workers.count:
                workers.submit(waiting.pop())
                running += 1
            for index, result in workers.wait():
                running -= 1
                if isinstance(result, WorkerDied):
                    raise CollectionError(f"{jobs[index]}: {result.cause}")
                yield index, result
    finally:
        workers.close()


def make_rows(arguments: Arguments, results: dict[EvaluationJob, Result]) -> list[Row]:
    """One row per environment and policy."""
    rows = []
    for env_id in arguments.envs:
        own = {job: result for job, result in results.items() if job.env_id == env_id}
        floors = {m.seed: r for m, r in own.items() if m.policy == "floor" and not isinstance(r, Score)}
        groups: dict[str, dict[str, list[Score]]] = {}
        for job, result in own.items():
            if isinstance(result, Score):
                runs = groups.setdefault(policy_name(job.policy), {})
                runs.setdefault(job.policy, []).append(result)
        for name, by_run in groups.items():
            rows.append(summarise(scene_set_name(env_id), name, list(by_run.values()), floors, arguments.seed))
    return rows


def key(job: EvaluationJob) -> str:
    """Identifies a match in scores.json; a run that was trained further plays anew."""
    is_run = (Path(job.policy) / RUN_FILE).exists()
    steps = f" after {load_run(Path(job.policy))['steps']}" if is_run else ""
    return f"{job.env_id} {job.policy}{steps} {job.seed} {job.max_steps}"


def restored(value: dict[str, Any] | int | None) -> Result:
    """A result read back from JSON."""
    return Score(**value) if isinstance(value, dict) else value


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("compare", Arguments, run, __doc__, words)
