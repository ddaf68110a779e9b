"""Collect decisions of canonical plans without physics: the scene, the contact chosen, and all that are as good.

    clutter-env decisions --objects 15 --decisions 5000 --out outputs/decisions/o15

Run the same command again after an interruption: scenes that are planned already are not planned again.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Arguments:
    """Collect decisions."""

    objects: int = 15
    """Objects on the table, the target among them."""
    decisions: int = 5000
    """Decisions wanted at least."""
    out: Path = Path("outputs/decisions")
    """Directory of the files; one that the same command made is continued."""
    layout: str = "paper"
    """Layout."""
    grasps: str = "side"
    """Grasp set: "side", "tilted", "top" or "all"."""
    obstructed: bool = True
    """Only targets that no side grasp reaches without moving something."""
    seed: int = 0
    """First seed of the scenes; the others follow in ascending order. Seeds from 1,000,000 on are for evaluation."""
    workers: int = 2
    """Number of processes."""


def run(arguments: Arguments) -> None:
    """Collect and print the counts."""
    import time
    from functools import partial

    from clutter_env.learning.demonstrations.decision_collect import DecisionJob, collect_decisions
    from clutter_env.learning.task import Task
    from clutter_env.parallel import run_jobs
    from clutter_env.reporting.progress import progress_bar

    keywords = {"layout": arguments.layout, "obstructed": arguments.obstructed}
    task = Task(f"clutter_env/Retrieve-o{arguments.objects}-v0", keywords)
    job = DecisionJob(task, arguments.grasps, arguments.decisions, arguments.seed)
    started = time.perf_counter()
    with progress_bar(total=arguments.decisions, unit="decision") as bar:

        def report(decisions: int) -> None:
            """Show how many decisions there are."""
            bar.update(min(decisions, arguments.decisions) - bar.n)

        counts = collect_decisions(job, arguments.out, partial(run_jobs, workers=arguments.workers), report)
    wall_s = time.perf_counter() - started
    print(f"{counts['decisions']} decisions in {arguments.out}")
    rate = f": {counts['made'] / wall_s * 3600:.0f} per hour" if counts["made"] else ""
    print(f"{counts['made']} of them made now, in {wall_s:.0f} s{rate}; {counts['without_plan']} scenes without a plan")
