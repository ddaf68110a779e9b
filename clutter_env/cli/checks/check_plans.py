"""Replay plans in a MuJoCo model of their own, at a tenth of the planner's step, and print the deepest penetration.

    python scripts/check_plans.py --layout shelf --objects 16 --grasps all --plans 20

Scenes are resets of the environment from --seed on. What counts as a contact is in `experiments/plans/replay.py`.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from clutter_env.reporting.command import run_command

TOLERANCE = 0.001
"""[m] Penetration that a plan may have."""


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    objects: int = 15
    """Number of objects, the target among them."""
    layout: str = "paper"
    """Layout of the table."""
    grasps: Literal["side", "tilted", "top", "all"] = "side"
    """Grasp set of the plans."""
    obstructed: bool = False
    """Leave out scenes in which a level gripper takes the target at once."""
    plans: int = 40
    """Plans to replay; scenes without a plan are counted apart."""
    seed: int = 400_000
    """First seed of the scenes."""
    time_limit: float = 60.0
    """[s] of wall time for one solve."""
    json: Path | None = None
    """Write the deepest penetration of each plan to this file too."""


def run(arguments: Arguments) -> None:
    """Solve, replay, report."""
    from clutter_env.envs.retrieve import RetrieveEnv
    from clutter_env.experiments.plans.replay import DeepestContact, PlanReplay
    from clutter_env.reporting.files import write_json
    from clutter_env.reporting.progress import progress_bar
    from planners import Infeasible, Scene, solve

    env = RetrieveEnv(num_objects=arguments.objects, layout=arguments.layout, obstructed=arguments.obstructed)
    found: dict[int, DeepestContact] = {}
    actions = clearances = without = 0
    with progress_bar(desc="plans", total=arguments.plans) as bar:
        for seed in itertools.count(arguments.seed):
            if len(found) == arguments.plans:
                break
            _, info = env.reset(seed=seed)
            scene = Scene.from_mujoco(env.model, env.data, env.robot)
            plan = solve(scene, info["target"], time_limit=arguments.time_limit, grasps=arguments.grasps)
            if isinstance(plan, Infeasible):
                without += 1
                continue
            found[seed] = PlanReplay(scene).deepest_contact(plan.actions)
            actions, clearances = actions + len(plan.actions), clearances + len(plan.clearances)
            bar.update()
    env.close()
    deep = {seed: contact for seed, contact in found.items() if contact.depth > TOLERANCE}
    worst = max(found.values(), default=DeepestContact())
    print(
        f"{arguments.layout}, {arguments.objects} objects, {arguments.grasps}: {len(found)} plans, {actions} actions, "
        f"{clearances} clearances, {without} scenes without a plan; deepest {_in_words(worst)}; "
        f"over {1e3 * TOLERANCE:.0f} mm: {len(deep)}"
    )
    for seed, contact in deep.items():
        print(f"  seed {seed}: {_in_words(contact)}")
    if arguments.json is not None:
        write_json(arguments.json, {str(seed): contact._asdict() for seed, contact in found.items()})


def _in_words(contact: tuple[float, tuple[str, str], str, str]) -> str:
    depth, geoms, action, phase = contact
    return f"{1e3 * depth:.3f} mm" + (f" ({' and '.join(geoms)}, {action}, {phase})" if depth else "")


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("check_plans", Arguments, run, __doc__, words)
