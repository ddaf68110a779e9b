"""Compare expert strategies, learned policies and controls on the same scenes.

    clutter-env compare --suites side-15-v3 --policies lookahead outputs/runs/maskable_ppo-skill-o15/*
    clutter-env compare --envs clutter_env/Retrieve-o15-v0 --obstructed 1 --policies lookahead my_module:Mine
    clutter-env compare --files outputs/evaluate/side-15-v3_*.json

The controls (greedy and random skills, the direct approach) always play. Runs of one algorithm that differ in their
seed form one row. Two Markdown tables and a picture are written to the output directory. Every score is written there
as soon as its episode ends: run the same command again after an interruption.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from clutter_env.cli.main import command_line

if TYPE_CHECKING:
    from clutter_env.evaluation.tables import Row

WHEN_INTERRUPTED = "run the same command again to go on"


@dataclass(frozen=True)
class Arguments:
    """Compare policies."""

    suites: tuple[str, ...] = ()
    """Suites whose scenes are played."""
    split: Literal["test", "validation"] = "test"
    """Split of the suites: "test" for results to report, "validation" to tune a policy."""
    envs: tuple[str, ...] = ()
    """Environments whose resets, from seed 1,000,000 on, are played. Of Retrieve also by skills."""
    obstructed: Literal[0, 1, 2, 3] = 0
    """Environments: least number of objects in the way of every side grasp of the target."""
    policies: tuple[str, ...] = ("lookahead",)
    """Names of policies. The help of `clutter-env evaluate` lists them."""
    files: tuple[Path, ...] = ()
    """Results files of `clutter-env evaluate`, whose scores are added unchecked. `clutter-env verify` confirms them."""
    scenes: int | None = None
    """Number of scenes of each environment (50 if not given) and suite (all if not given)."""
    feasibility: Literal["oracle", "none"] = "oracle"
    """For policies that act by skills: whether skills without a free grasp are refused, or tried all the same."""
    count_crashes: bool = False
    """Count an exception of a policy as a failed episode. Otherwise it ends the comparison."""
    workers: int = 2
    """Number of processes."""
    ray: str = ""
    """Address of Ray ("auto", "local", …): play there instead of in processes of this machine."""
    trust: bool = False
    """Load models of Stable-Baselines3 (ALGORITHM:FILE.zip), which executes code that is in the file."""
    python: str = ""
    """For lerobot:DIRECTORY: the interpreter of an environment in which LeRobot is installed."""
    seed: int = 0
    """Random seed of the random policies and of the bootstrap."""
    out: Path = Path("outputs/compare")
    """Directory of table.md, plot.png and results.jsonl."""
    json: Path | None = None
    """Write the rows to this file."""


def run(arguments: Arguments) -> None:
    """Play, summarise, print."""
    from clutter_env.evaluation.picture import plot
    from clutter_env.evaluation.tables import markdown, markdown_by_floor, summarise
    from clutter_env.evaluation.verify import claimed
    from clutter_env.reporting.files import write_json

    read = [claimed(file) for file in arguments.files]
    rows = [summarise(found.policy, [found], arguments.seed) for found in read]
    if arguments.suites or arguments.envs or not rows:
        rows = play(arguments) + rows
    arguments.out.mkdir(parents=True, exist_ok=True)
    tables = f"{markdown(rows)}\n{markdown_by_floor(rows)}"
    print(tables)
    command = command_line("clutter-env compare", arguments, leave_out=("workers", "ray", "out", "json"))
    (arguments.out / "table.md").write_text(f"```sh\n{command}\n```\n\n{tables}")
    plot(rows, arguments.out / "plot.png")
    if arguments.json is not None:
        write_json(arguments.json, rows)


def play(arguments: Arguments) -> list[Row]:
    """Play the scenes that have not been played. Return the rows of the table."""
    from clutter_env.errors import LearningError
    from clutter_env.evaluation.compare import Comparison, compare
    from clutter_env.evaluation.evaluate import EPISODE_S, ResultRecords
    from clutter_env.evaluation.scenes import SceneSet
    from clutter_env.reporting.progress import LateBar

    if not arguments.suites and not arguments.envs:
        raise LearningError("name scenes: --suites, or --envs with --obstructed and --scenes; or --files of results")
    obstructed = {0: False, 1: True}.get(arguments.obstructed, arguments.obstructed)
    count = 50 if arguments.scenes is None else arguments.scenes
    sets = [SceneSet(name, arguments.split, count=arguments.scenes) for name in arguments.suites]
    sets += [SceneSet(env_id=name, obstructed=obstructed, count=count) for name in arguments.envs]
    options = {name: getattr(arguments, name) for name in ("seed", "feasibility", "trust", "python")}
    comparison = Comparison(sets, arguments.policies, **options)
    records, total = ResultRecords(arguments.out / "results.jsonl"), comparison.num_episodes
    chosen = {name: getattr(arguments, name) for name in ("workers", "ray", "count_crashes")}
    with LateBar(total=total, unit="episode", seconds=EPISODE_S * total / arguments.workers) as bar:
        return compare(comparison, records, begin=bar.begin, tick=bar.update, **chosen)
