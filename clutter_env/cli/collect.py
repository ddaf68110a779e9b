"""Collect expert demonstrations in parallel; each is kept only if it replays bit for bit in a fresh process.

    python scripts/collect_demos.py --env clutter_env/Retrieve-o15-v0 --episodes 200 --out outputs/demos/o15

Run the same command again after an interruption: what is there already stays and is not made again.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tqdm import tqdm

from clutter_env.cli.command import run_command
from clutter_env.learning.demonstrations.collect import Outcome, collect, demonstrate
from clutter_env.learning.demonstrations.dataset import Dataset, Job, write_json
from clutter_env.learning.demonstrations.experts import expert_names
from clutter_env.learning.demonstrations.minari_export import export_minari
from clutter_env.learning.errors import LearningError
from clutter_env.learning.task import HELD_OUT, Task
from clutter_env.parallel.workers import LocalWorkers, RayWorkers, Workers


@dataclass(frozen=True)
class Arguments:
    """Collect demonstrations."""

    env: str = "clutter_env/Retrieve-o15-v0"
    """Environment id."""
    episodes: int = 200
    """Successful episodes wanted."""
    out: Path = Path("outputs/demos")
    """Directory of the episodes' files; one that was begun by the same command is continued."""
    strategy: str = ""
    """The expert: a strategy of the planner, or the script of a goal environment; empty for the first."""
    control_mode: Literal["joint", "ee", ""] = ""
    """Control mode; empty for the environment's own."""
    layout: str = ""
    """Layout; empty for the environment's own."""
    seed: int = 0
    """First seed; the others follow upwards. Seeds from 1,000,000 on are for evaluation."""
    workers: int = 2
    """Processes."""
    format: Literal["minari", "hdf5"] = "minari"
    """"minari" writes a Minari dataset beside the episodes' files, "hdf5" does not."""
    dataset_id: str = ""
    """Minari's name of the dataset; empty: made from the environment's id."""
    minari_root: Path | None = None
    """Directory of Minari datasets; without it, one in `out`."""
    ray: str = ""
    """Ray's address ("auto", "local", …): collect there instead of in processes of this machine."""
    json: Path | None = None
    """Write the counts to this file."""


def run(arguments: Arguments) -> None:
    """Collect, say what came of it, and export."""
    job = make_job(arguments)
    dataset = Dataset.open_for(job, arguments.out)
    started = time.perf_counter()
    with dataset.locked():
        seeds, made = collect_episodes(arguments, job, dataset)
    wall_s = time.perf_counter() - started
    rejected = Counter(reason.splitlines()[0] for reason in dataset.reasons().values())
    print(f"{len(seeds)} episodes in {dataset.directory}, seeds {seeds[0]} to {seeds[-1]}")
    print(
        f"{made} made now in {wall_s:.0f} s"
        + (f": {made / wall_s * 3600:.0f} per hour, replay included" if made else "")
    )
    for reason, count in rejected.most_common():
        print(f"  {count} rejected: {reason}")
    if arguments.format == "minari":
        print(f"Minari dataset: {export(arguments, dataset)}")
    if arguments.json is not None:
        content = {"seeds": seeds, "made": made, "wall_s": wall_s, "rejected": rejected, "job": job.identity()}
        write_json(arguments.json, content)


def make_job(arguments: Arguments) -> Job:
    """The job that the arguments describe."""
    if arguments.episodes < 1:
        raise LearningError(f"--episodes {arguments.episodes} is not valid; it must be at least 1")
    if not 0 <= arguments.seed < HELD_OUT:
        raise LearningError(f"--seed {arguments.seed} is not valid; it must be from 0 to {HELD_OUT - 1}")
    chosen = {"control_mode": arguments.control_mode, "layout": arguments.layout}
    keywords = {name: value for name, value in chosen.items() if value}
    task = Task(arguments.env, keywords)
    task.make().close()
    known = expert_names(arguments.env)
    if not known:
        raise LearningError(
            f"no expert acts in {arguments.env}; collect in the Retrieve environment of as many objects"
        )
    expert = arguments.strategy or known[0]
    if expert not in known:
        raise LearningError(f"--strategy {expert!r} is not valid for {arguments.env}; valid ones: {', '.join(known)}")
    return Job(task, expert, arguments.episodes, arguments.seed)


def collect_episodes(arguments: Arguments, job: Job, dataset: Dataset) -> tuple[list[int], int]:
    """Collect with a progress bar: the seeds of the dataset, and how many episodes were made now."""
    workers: Workers[Outcome]
    if arguments.ray:
        workers = RayWorkers(demonstrate, job, arguments.workers, arguments.ray)
    else:
        workers = LocalWorkers(demonstrate, job, arguments.workers)
    there = len(list(dataset.episodes_directory.glob("*.hdf5")))
    made = 0
    try:
        with tqdm(total=job.episodes, initial=min(there, job.episodes), unit="episode") as bar:

            def report(outcome: Outcome) -> None:
                nonlocal made
                if outcome.content:
                    made += 1
                    bar.update()
                bar.set_postfix(seed=outcome.seed, last=outcome.reason.partition(":")[0] or "kept")

            return collect(job, dataset, workers, report), made
    finally:
        workers.close()


def export(arguments: Arguments, dataset: Dataset) -> Path:
    """Write the Minari dataset."""
    name = arguments.dataset_id or arguments.env.lower().removesuffix("-v0") + "-v0"
    about = (
        f"{len(dataset)} demonstrations of {arguments.env}; every one replays bit for bit from its seed and actions."
    )
    root = arguments.minari_root or arguments.out / "minari"
    return export_minari(dataset, root, name, about, replace=arguments.minari_root is None)


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("collect", Arguments, run, __doc__, words)
