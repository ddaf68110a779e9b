"""Draw the learning curves of training runs that learned from rewards.

python scripts/stock_curves.py outputs/runs/tqc-armreach/* --out docs/images/stock_learning.png
"""

from __future__ import annotations

import json
from pathlib import Path

import tyro
from matplotlib.figure import Figure

from clutter_env.policies.reinforcement import ALGORITHMS
from clutter_env.policies.runs import HISTORY_FILE, load_run

_SHOWN = ("layout", "object_set")
"""Keyword arguments of the environment that stand in the legend."""


def main(runs: tyro.conf.Positional[tuple[Path, ...]], out: Path = Path("outputs/curves.png")) -> None:
    """Success on held-out scenes against steps of the environment, a line for each run; prints the last points."""
    figure = Figure(figsize=(6.5, 3.6), layout="constrained")
    axis = figure.subplots()
    curves: dict[Path, list[str]] = {}
    for run in sorted(runs):
        if not (run / HISTORY_FILE).exists():
            raise SystemExit(f"{run} has no {HISTORY_FILE}: it has not come to its first checkpoint")
        about = load_run(run)
        environment = about["task"]["env_id"].rpartition("/")[2]
        learner = ALGORITHMS[about["algorithm"]].__name__
        chosen = [str(about["task"]["keywords"][key]) for key in _SHOWN if key in about["task"]["keywords"]]
        curves[run] = [environment, *chosen, learner, f"seed {about['seed']}"]
    alike = [part for part in next(iter(curves.values()), []) if all(part in parts for parts in curves.values())]
    for run, parts in curves.items():
        points = json.loads((run / HISTORY_FILE).read_text())
        label = ", ".join(part for part in parts if len(curves) == 1 or part not in alike)
        axis.plot([point["steps"] for point in points], [point["success"] for point in points], marker=".", label=label)
        last = points[-1]
        print(f"{', '.join(parts)}: {last['success']:.2f} after {last['steps']:,} steps, {last['cpu_s']:.0f} CPU s")
    axis.set(xlabel="steps of the environment", ylabel="success on held-out scenes", ylim=(-0.02, 1.03))
    axis.set_title(", ".join(alike) if len(curves) > 1 else "", fontsize="medium")
    axis.set_xlim(left=0)
    axis.xaxis.set_major_formatter(lambda steps, _: f"{steps:,.0f}")
    axis.grid(alpha=0.3)
    axis.legend(fontsize="small")
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=120)


if __name__ == "__main__":
    tyro.cli(main)
