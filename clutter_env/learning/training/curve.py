"""Success of learned movers against the number of demonstrations, with the planner's decisions."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch

from clutter_env.learning.comparison.evaluation import held_out_seeds
from clutter_env.learning.demonstrations.dataset import Dataset
from clutter_env.learning.errors import LearningError
from clutter_env.learning.keyframes.motions import motions_of
from clutter_env.learning.policies.movers import fit_mover
from clutter_env.learning.policies.runs import MOVER_LEARNERS
from clutter_env.learning.training.movers import clean_successes, decider_of, task_of
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.reporting.files import write_json
from clutter_env.reporting.intervals import Interval, success_interval

__all__ = ["Curve", "Point", "draw", "markdown", "measure", "points"]


@dataclass(frozen=True)
class Point:
    """One training: which demonstrations, how many, which learner and seed; and on how many scenes it is evaluated."""

    demonstrations: str
    algorithm: str
    count: int
    seed: int
    steps: int
    scenes: int


@dataclass(frozen=True)
class Curve:
    """What is measured.

    Attributes:
        demonstrations: directories of datasets.
        algorithms: of `MOVER_LEARNERS`.
        counts: numbers of demonstrations; those that a dataset lacks are left out.
        seeds: training seeds of each point.
        steps: gradient steps of each training.
        scenes: held-out scenes, drawn as those of the demonstrations were.
    """

    demonstrations: Sequence[Path]
    algorithms: Sequence[str]
    counts: Sequence[int]
    seeds: int
    steps: int
    scenes: int


def points(curve: Curve) -> list[Point]:
    """All trainings of a curve.

    Raises:
        LearningError: an algorithm that is not known, with the known ones; or a number below 1.
        DatasetError: a directory without a complete dataset, or of an expert that is no planner.
    """
    for name in curve.algorithms:
        if name not in MOVER_LEARNERS:
            raise LearningError(f"no algorithm {name!r}; those that learn motions: {', '.join(MOVER_LEARNERS)}")
    if min(curve.seeds, curve.steps, curve.scenes, *curve.counts) < 1:
        raise LearningError("counts, seeds, steps and scenes must be at least 1")
    found = []
    for directory in curve.demonstrations:
        dataset = Dataset(directory)
        decider_of(dataset)
        for algorithm in curve.algorithms:
            for count in (count for count in curve.counts if count <= len(dataset)):
                for seed in range(curve.seeds):
                    found.append(Point(str(directory), algorithm, count, seed, curve.steps, curve.scenes))
    return found


def measure(
    todo: Sequence[Point], file: Path, workers: int, tick: Callable[[], object] = lambda: None
) -> dict[Point, list[bool]]:
    """Clean success on every scene, for all points; results in the file are not made again.

    Raises:
        LearningError: a training failed, or its worker died.
    """
    known: dict[str, list[bool]] = json.loads(file.read_text()) if file.exists() else {}
    missing = [point for point in todo if _key(point) not in known]
    for _ in range(len(todo) - len(missing)):
        tick()
    for point, result in run_jobs(_train_and_play, missing, workers):
        if isinstance(result, Crash | Killed):
            raise LearningError(f"{_key(point)}: {result}")
        known[_key(point)] = result
        write_json(file, known)
        tick()
    return {point: known[_key(point)] for point in todo}


def markdown(results: Mapping[Point, Sequence[bool]]) -> str:
    """A table: one row for each number of demonstrations, with the 95% interval over seeds and scenes of `compare`."""
    lines = ["| demonstrations | learner | number | clean success | seeds × scenes |", "|---|---|---|---|---|"]
    for (source, algorithm, count), runs in _groups(results).items():
        lines.append(f"| {Path(source).name} | {algorithm} | {count} | {_rate(runs)} | {len(runs)} × {len(runs[0])} |")
    return "\n".join(lines)


def draw(results: Mapping[Point, Sequence[bool]], file: Path) -> None:
    """The curves as a figure; missing directories are made."""
    from matplotlib.figure import Figure  # the trainings do without it

    figure = Figure(figsize=(6.5, 4), layout="constrained")
    axis = figure.subplots()
    groups = _groups(results)
    for source, algorithm in dict.fromkeys((source, algorithm) for source, algorithm, _ in groups):
        counts = sorted(count for one, other, count in groups if (one, other) == (source, algorithm))
        rates = [_rate(groups[source, algorithm, count]) for count in counts]
        middle = [rate.mean for rate in rates]
        below = [rate.mean - rate.low for rate in rates]
        above = [rate.high - rate.mean for rate in rates]
        axis.errorbar(counts, middle, (below, above), marker="o", capsize=3, label=f"{algorithm}, {Path(source).name}")
    axis.set(xscale="log", xlabel="demonstrations", ylabel="clean success", ylim=(0, 1.03))
    shown = sorted({count for *_, count in groups})
    axis.set_xticks(shown, [f"{count:,}" for count in shown])
    axis.minorticks_off()
    axis.grid(alpha=0.3)
    axis.legend(fontsize="small")
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=120)


def _train_and_play(point: Point) -> list[bool]:
    """Train, and play all scenes; in a worker."""
    torch.set_num_threads(1)
    dataset = Dataset(Path(point.demonstrations))
    env: Any = task_of(dataset).make()
    motions = list(motions_of(islice(dataset, point.count)))
    fitted = fit_mover(point.algorithm, env.unwrapped.robot, motions, point.steps, point.seed)
    successes = clean_successes(env, decider_of(dataset), fitted.mover, held_out_seeds(point.scenes))
    env.close()
    return successes


def _rate(runs: Sequence[Sequence[bool]]) -> Interval:
    """Clean success of the seeds of a point."""
    return success_interval(runs, np.random.default_rng(0))


def _groups(results: Mapping[Point, Sequence[bool]]) -> dict[tuple[str, str, int], list[Sequence[bool]]]:
    """The results of the seeds, by demonstrations, learner and number."""
    groups: dict[tuple[str, str, int], list[Sequence[bool]]] = {}
    for point, successes in results.items():
        groups.setdefault((point.demonstrations, point.algorithm, point.count), []).append(successes)
    return groups


def _key(point: Point) -> str:
    return " ".join(f"{name}={value}" for name, value in asdict(point).items())
