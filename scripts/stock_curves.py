"""Draw the learning curves that `scripts/stock_learning.py` wrote.

python scripts/stock_curves.py outputs/stock/ArmReach-*.json --out docs/images/stock_learning.png
"""

from __future__ import annotations

import json
from pathlib import Path

import tyro
from matplotlib.figure import Figure


def main(files: tyro.conf.Positional[tuple[Path, ...]], out: Path = Path("outputs/stock/curves.png")) -> None:
    """Success on held-out scenes against steps of the environment, a line for each file; prints the last points."""
    figure = Figure(figsize=(6.5, 3.6), layout="constrained")
    axis = figure.subplots()
    for file in sorted(files):
        curve = json.loads(file.read_text())
        points = curve["points"]
        label = f"{curve['env']}, {curve['algo'].upper()}, seed {curve['seed']}"
        axis.plot([point["steps"] for point in points], [point["success"] for point in points], marker=".", label=label)
        last = points[-1]
        print(f"{label}: {last['success']:.2f} after {last['steps']:,} steps, {last['cpu_s']:.0f} CPU s")
    axis.set(xlabel="steps of the environment", ylabel="success on 100 held-out scenes", ylim=(-0.02, 1.03))
    axis.xaxis.set_major_formatter(lambda steps, _: f"{steps:,.0f}")
    axis.grid(alpha=0.3)
    axis.legend(fontsize="small")
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=120)


if __name__ == "__main__":
    tyro.cli(main)
