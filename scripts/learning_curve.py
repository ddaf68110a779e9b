"""Success of learned motions against the number of demonstrations, with the planner's choice of actions.

    python -m scripts.learning_curve --demos outputs/demos/o1-canonical outputs/demos/o1-lookahead

For every dataset, number of demonstrations and seed a motion policy is trained and evaluated on held-out scenes, which
are drawn as those of the dataset were. A Markdown table, a figure and all results as JSON are written to the output
directory; results that are there already are not made again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro

from clutter_env.data.dataset import Dataset
from clutter_env.errors import LearningError
from clutter_env.evaluation.score import play_scene
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.policies.motion.keyframe_policy import KeyframePolicy
from clutter_env.policies.two_level import TwoLevelPolicy
from clutter_env.policies.weights import trained_in
from clutter_env.reporting.files import write_json
from clutter_env.reporting.intervals import success_interval
from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import markdown_table
from clutter_env.seeds import held_out_seeds
from scripts.shipped_weights.motion_examples import motions_of
from scripts.shipped_weights.motions import fit_motions, high_level_of


@dataclass(frozen=True)
class Arguments:
    """Measure success against the number of demonstrations."""

    demos: tuple[Path, ...]
    """Datasets of `clutter-env collect`."""
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


@dataclass(frozen=True)
class Point:
    """One training, and the number of scenes on which it is evaluated."""

    demonstrations: str
    count: int
    seed: int
    steps: int
    scenes: int

    def __str__(self) -> str:
        return " ".join(f"{name}={value}" for name, value in asdict(self).items())


def run(arguments: Arguments) -> None:
    """Measure, print, write."""
    points = [
        Point(str(directory), count, seed, arguments.steps, arguments.scenes)
        for directory in arguments.demos
        for count in arguments.counts
        if count <= len(Dataset(directory))
        for seed in range(arguments.seeds)
    ]
    file = arguments.out / "results.json"
    known: dict[str, list[bool]] = json.loads(file.read_text()) if file.exists() else {}
    missing = [point for point in points if str(point) not in known]
    with progress_bar(total=len(points), initial=len(points) - len(missing), unit="training") as bar:
        for point, result in run_jobs(train_and_play, missing, arguments.workers):
            if isinstance(result, Crash | Killed):
                raise LearningError(f"{point}: {result}")
            known[str(point)] = result
            write_json(file, known)
            bar.update()
    groups: dict[tuple[str, int], list[list[bool]]] = {}
    for point in points:
        groups.setdefault((Path(point.demonstrations).name, point.count), []).append(known[str(point)])
    rates = {key: success_interval(runs, np.random.default_rng(0)) for key, runs in groups.items()}
    rows = [
        (source, str(count), str(rates[source, count]), f"{len(runs)} × {len(runs[0])}")
        for (source, count), runs in groups.items()
    ]
    table = markdown_table(("demonstrations", "number", "clean success", "seeds × scenes"), rows)
    (arguments.out / "table.md").write_text(table)
    draw(rates, arguments.out / "plot.png")
    print(table)


def train_and_play(point: Point) -> list[bool]:
    """Train, and play all scenes: clean success of each; in a worker."""
    torch.set_num_threads(1)
    dataset = Dataset(Path(point.demonstrations))
    high_level, env = high_level_of(dataset), dataset.task.make()
    motions = list(motions_of(islice(dataset, point.count)))
    network = fit_motions(env.get_wrapper_attr("robot"), motions, point.steps, point.seed)
    info = trained_in(env, "motions", high_level.grasps)
    policy = TwoLevelPolicy(high_level, KeyframePolicy(network, info))
    successes = [play_scene(seed, env, policy).clean for seed in held_out_seeds(point.scenes)]
    env.close()
    return successes


def draw(rates: Mapping[tuple[str, int], Any], file: Path) -> None:
    """The curves as a figure."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5, 4), layout="constrained")
    axis = figure.subplots()
    for source in dict.fromkeys(source for source, _ in rates):
        counts: Sequence[int] = sorted(count for other, count in rates if other == source)
        found = [rates[source, count] for count in counts]
        errors = [rate.mean - rate.low for rate in found], [rate.high - rate.mean for rate in found]
        axis.errorbar(counts, [rate.mean for rate in found], errors, marker="o", capsize=3, label=source)
    axis.set(xscale="log", xlabel="demonstrations", ylabel="clean success", ylim=(0, 1.03))
    shown = sorted({count for _, count in rates})
    axis.set_xticks(shown, [f"{count:,}" for count in shown])
    axis.minorticks_off()
    axis.grid(alpha=0.3)
    axis.legend(fontsize="small")
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    run(tyro.cli(Arguments, description=__doc__))
