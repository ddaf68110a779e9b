"""Compare canonical plans with ordinary ones: how much they differ from scene to scene, and what they cost.

    python -m clutter_env.cli.data.canonical_plans

Draws the figure and prints the table of docs/learning.md. Nothing is simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.experiments.plans.spread import plan_scene, spread_table
from clutter_env.experiments.plans.spread_figure import plot_spread
from clutter_env.reporting.command import run_command
from clutter_env.reporting.progress import progress_bar
from planners.planner import Planner


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    objects: int = 15
    """Objects on every table."""
    layout: str = "paper"
    """Layout."""
    grasps: str = "side"
    """Grasp set."""
    obstructed: bool = True
    """Only targets that no side grasp reaches without moving something."""
    scenes: int = 100
    """Number of scenes."""
    seed: int = 900_000
    """First seed."""
    out: Path = Path("outputs/canonical_plans.png")
    """File of the figure."""


def run(arguments: Arguments) -> None:
    """Plan all scenes twice, draw, print."""
    env = RetrieveEnv(num_objects=arguments.objects, layout=arguments.layout, obstructed=arguments.obstructed)
    seeds = range(arguments.seed, arguments.seed + arguments.scenes)
    plans = {}
    for name, canonical in (("ordinary", False), ("canonical", True)):
        planner = Planner(env.robot, grasps=arguments.grasps, canonical=canonical)
        planner.warmup()
        plans[name] = [plan_scene(env, planner, seed) for seed in progress_bar(seeds, desc=name, unit="scene")]
    plot_spread(plans, arguments.out)
    print(spread_table(plans))
    print(f"figure: {arguments.out}")


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("canonical_plans", Arguments, run, __doc__, words)


if __name__ == "__main__":
    main()
