"""Success of learned motions against the number of demonstrations, with the planner's decisions.

    clutter-env curve --demos outputs/demos/o1-canonical outputs/demos/o1-lookahead --counts 10 30 100 300 1000

For every dataset, learner, number of demonstrations and seed a mover is trained and evaluated on held-out scenes, which
are drawn as those of the dataset were. A Markdown table, a figure and all results as JSON are written to the output
directory; results that are there already are not made again.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from clutter_env.cli.main import command_line


@dataclass(frozen=True)
class Arguments:
    """Measure success against the number of demonstrations."""

    demos: tuple[Path, ...]
    """Datasets of `clutter-env collect`."""
    algorithms: tuple[str, ...] = ("keyframes",)
    """"keyframes", "chunks", "flow"."""
    counts: tuple[int, ...] = (10, 30, 100, 300, 1000)
    """Numbers of demonstrations; those that a dataset lacks are left out."""
    seeds: int = 3
    """Training seeds of each point."""
    steps: int = 4000
    """Gradient steps of each training."""
    scenes: int = 100
    """Number of held-out scenes."""
    workers: int = 2
    """Number of processes."""
    out: Path = Path("outputs/curve")
    """Directory of table.md, plot.png and results.json."""


def run(arguments: Arguments) -> None:
    """Measure, print, write."""
    from clutter_env.learning.training.curve import Curve, draw, markdown, measure, points
    from clutter_env.reporting.progress import progress_bar

    curve = Curve(
        demonstrations=arguments.demos,
        algorithms=arguments.algorithms,
        counts=arguments.counts,
        seeds=arguments.seeds,
        steps=arguments.steps,
        scenes=arguments.scenes,
    )
    todo = points(curve)
    arguments.out.mkdir(parents=True, exist_ok=True)
    with progress_bar(total=len(todo), unit="training") as bar:
        results = measure(todo, arguments.out / "results.json", arguments.workers, bar.update)
    table = markdown(results)
    command = command_line("clutter-env curve", arguments, leave_out=("workers", "out"))
    (arguments.out / "table.md").write_text(f"```sh\n{command}\n```\n\n{table}\n")
    draw(results, arguments.out / "plot.png")
    print(table)
