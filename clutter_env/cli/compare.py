"""Compare expert strategies, baselines and trained policies on the same held-out scenes.

    clutter-env compare --envs clutter_env/Retrieve-o5-v0 clutter_env/Retrieve-o10-v0 \\
        --policies lookahead random greedy --runs outputs/runs/maskable_ppo-skill-* --scenes 50

Runs of one algorithm that differ in their seed form one row. A Markdown table, all scores as JSON and a plot over the
number of objects are written to the output directory; scores that are there already are not made again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from clutter_env.cli.command import command_line, run_command


@dataclass(frozen=True)
class Arguments:
    """Compare policies."""

    envs: tuple[str, ...] = ("clutter_env/Retrieve-o5-v0",)
    """Environments; Skill policies play the scenes of the Retrieve environment with as many objects."""
    policies: tuple[str, ...] = ("lookahead", "random", "greedy")
    """Strategies of the planner, "scripted", "random", "greedy"."""
    runs: tuple[Path, ...] = ()
    """Directories of training runs; each plays the environments whose scenes it was trained on."""
    scenes: int = 50
    """Number of held-out scenes."""
    max_steps: int = 1500
    """Steps of 0.05 s after which an episode of low-level actions is cut off."""
    workers: int = 2
    """Number of processes."""
    ray: str = ""
    """Address of Ray ("auto", "local", …): play there instead of in processes of this machine."""
    seed: int = 0
    """Random seed of the bootstrap."""
    out: Path = Path("outputs/compare")
    """Directory of table.md, plot.png and scores.json."""
    json: Path | None = None
    """Write the rows to this file."""


def run(arguments: Arguments) -> None:
    """Play, summarise, print."""
    from functools import partial

    from tqdm import tqdm

    from clutter_env.learning.comparison.compare import Comparison, evaluate_all, make_jobs, make_rows
    from clutter_env.learning.comparison.tables import markdown, plot
    from clutter_env.parallel.jobs import run_jobs
    from clutter_env.reporting.json_file import write_json

    comparison = Comparison(
        envs=arguments.envs,
        policies=arguments.policies,
        runs=arguments.runs,
        scenes=arguments.scenes,
        max_steps=arguments.max_steps,
        seed=arguments.seed,
    )
    jobs = make_jobs(comparison)
    arguments.out.mkdir(parents=True, exist_ok=True)
    workers = partial(run_jobs, workers=arguments.workers, ray=arguments.ray)
    with tqdm(total=len(jobs), unit="episode") as bar:
        results = evaluate_all(jobs, arguments.out / "scores.json", workers, lambda done: bar.update(done - bar.n))
    rows = make_rows(comparison, results)
    table = markdown(rows)
    command = command_line("compare", arguments, leave_out=("workers", "ray", "out", "json"))
    (arguments.out / "table.md").write_text(f"```sh\n{command}\n```\n\n{table}")
    plot(rows, arguments.out / "plot.png")
    print(table)
    if arguments.json is not None:
        write_json(arguments.json, rows)


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("compare", Arguments, run, __doc__, words)
