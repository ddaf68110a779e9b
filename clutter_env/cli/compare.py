"""Compare expert strategies, learned policies and controls on the same scenes.

    clutter-env compare --suites side-15-v1 --policies lookahead --runs outputs/runs/maskable_ppo-skill-o15/*
    clutter-env compare --envs clutter_env/Retrieve-o15-v0 --obstructed 1 --policies lookahead my_module:Mine

The controls (greedy and random skills, the bulldozer) always play. Runs of one algorithm that differ in their seed form
one row. Two Markdown tables and a picture are written to the output directory; every result is written there as soon as
its episode ends: run the same command again after an interruption.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from clutter_env.cli.main import command_line

if TYPE_CHECKING:
    from clutter_env.learning.comparison.scene_sets import SceneSet


@dataclass(frozen=True)
class Arguments:
    """Compare policies."""

    suites: tuple[str, ...] = ()
    """Suites whose scenes are played."""
    split: Literal["test", "validation"] = "test"
    """Split of the suites: "test" for results to report, "validation" to tune a policy."""
    envs: tuple[str, ...] = ()
    """Environments whose resets, from seed 1,000,000 on, are played; of Retrieve also by skills."""
    obstructed: Literal[0, 1, 2, 3] = 0
    """Environments: least number of objects in the way of every side grasp of the target."""
    policies: tuple[str, ...] = ("lookahead",)
    """Names of policies, as for `clutter-env evaluate`; or module:Class."""
    runs: tuple[Path, ...] = ()
    """Directories of training runs; each plays the scenes of its kind with as many objects."""
    scenes: int | None = None
    """Number of scenes of each environment (50 if not given) and suite (all if not given)."""
    feasibility: Literal["oracle", "none"] = "oracle"
    """For policies that act by skills: whether skills without a free grasp are refused, or tried all the same."""
    workers: int = 2
    """Number of processes."""
    ray: str = ""
    """Address of Ray ("auto", "local", …): play there instead of in processes of this machine."""
    seed: int = 0
    """Random seed of the random policies and of the bootstrap."""
    out: Path = Path("outputs/compare")
    """Directory of table.md, plot.png and results.jsonl."""
    json: Path | None = None
    """Write the rows to this file."""


def run(arguments: Arguments) -> None:
    """Play, summarise, print."""
    from functools import partial

    from clutter_env.learning.comparison.compare import Comparison, evaluate_all, make_jobs, make_rows
    from clutter_env.learning.comparison.picture import plot
    from clutter_env.learning.comparison.records import ResultRecords
    from clutter_env.learning.comparison.tables import markdown, markdown_by_floor
    from clutter_env.parallel import run_jobs
    from clutter_env.reporting.files import write_json
    from clutter_env.reporting.progress import progress_bar

    comparison = Comparison(
        scene_sets=scene_sets(arguments),
        policies=arguments.policies,
        runs=arguments.runs,
        seed=arguments.seed,
        feasibility=arguments.feasibility,
    )
    jobs = make_jobs(comparison)
    records = ResultRecords(arguments.out / "results.jsonl")
    workers = partial(run_jobs, workers=arguments.workers, ray=arguments.ray)
    with progress_bar(total=len(jobs), unit="episode") as bar:
        results = evaluate_all(jobs, records, workers, lambda done: bar.update(done - bar.n))
    rows = make_rows(comparison, results)
    tables = f"{markdown(rows)}\n{markdown_by_floor(rows)}"
    command = command_line("clutter-env compare", arguments, leave_out=("workers", "ray", "out", "json"))
    (arguments.out / "table.md").write_text(f"```sh\n{command}\n```\n\n{tables}")
    plot(rows, arguments.out / "plot.png")
    print(tables)
    if arguments.json is not None:
        write_json(arguments.json, rows)


def scene_sets(arguments: Arguments) -> list[SceneSet]:
    """The sets of scenes that the arguments name.

    Raises:
        LearningError: they name none, or a number of scenes that there is not.
        SuiteError: no such suite.
    """
    from clutter_env.learning.comparison.scene_sets import SceneSet
    from clutter_env.learning.errors import LearningError

    if not arguments.suites and not arguments.envs:
        raise LearningError("name scenes: --suites, or --envs with --obstructed and --scenes")
    obstructed = True if arguments.obstructed == 1 else arguments.obstructed or False
    of_suites = [SceneSet(name, arguments.split, count=arguments.scenes) for name in arguments.suites]
    count = arguments.scenes or 50
    return of_suites + [SceneSet(env_id=name, obstructed=obstructed, count=count) for name in arguments.envs]
