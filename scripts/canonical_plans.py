"""Compare canonical plans with ordinary ones: how much they differ from scene to scene, and what they cost.

    python scripts/canonical_plans.py --out docs/images/canonical_plans.png

Draws the figure and prints the table of the documentation. Nothing is simulated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tyro
from matplotlib.figure import Figure
from numpy.typing import NDArray

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import markdown_table
from planners.clock import cpu_seconds
from planners.contact import Contact, contact_of
from planners.planner import Planner
from planners.scene import Scene
from planners.tamp.solution import Solution

Array = NDArray[np.float64]

BINS = 24
"""Classes of the base's yaw relative to the gripper's, 15° each."""
_SAME_CONFIGURATION = 0.5
"""[rad] by which joints of configurations of one cluster differ at most."""


class PlannedContact(NamedTuple):
    """A pick-place action of a plan, and the arm configuration (8,) there."""

    contact: Contact
    q: Array


class PlannedScene(NamedTuple):
    """The plan of one scene; durations [s] are simulated time and CPU time."""

    seed: int
    floor: int | None  # minimum number of clearances, if it is proved
    clearances: int | None  # of the plan; None if there is none
    duration: float
    planning_s: float
    contacts: tuple[PlannedContact, ...]


def main(
    objects: int = 15,
    layout: str = "paper",
    grasps: str = "side",
    obstructed: bool = True,
    scenes: int = 100,
    seed: int = 900_000,
    out: Path = Path("outputs/canonical_plans.png"),
) -> None:
    """Plan all scenes twice, draw, print.

    Args:
        objects: Objects on every table.
        layout: Layout.
        grasps: Grasp set.
        obstructed: Only targets that no side grasp reaches without moving something.
        scenes: Number of scenes.
        seed: First seed.
        out: File of the figure.
    """
    env = RetrieveEnv(num_objects=objects, layout=layout, obstructed=obstructed)
    plans = {}
    for name, canonical in (("ordinary", False), ("canonical", True)):
        planner = Planner(env.robot, grasps=grasps, canonical=canonical)
        planner.warmup()
        seeds = progress_bar(range(seed, seed + scenes), desc=name, unit="scene")
        plans[name] = [plan_scene(env, planner, one) for one in seeds]
    plot_spread(plans, out)
    print(f"{spread_table(plans)}figure: {out}")


def plan_scene(env: RetrieveEnv, planner: Planner, seed: int) -> PlannedScene:
    """Plan the scene of a seed; nothing is simulated."""
    _, info = env.reset(seed=seed)
    scene = Scene.from_mujoco(env.model, env.data, env.robot, movable=env.object_names, support=env.support_name)
    floor = planner.clearance_floor(scene, info["target"])
    proved, before = floor.count if floor.proved else None, cpu_seconds()
    found = planner.solve(scene, info["target"])
    spent = cpu_seconds() - before
    if not isinstance(found, Solution):
        return PlannedScene(seed, proved, None, math.nan, spent, ())
    contacts = []
    for action in found.actions:
        contact = contact_of(action)
        if contact is not None:
            start = next(phase.start for phase in action.trajectory.phases if phase.name in ("close", "open"))
            contacts.append(PlannedContact(contact, action.trajectory.sample(start).q))
    return PlannedScene(seed, proved, len(found.clearances), found.duration, spent, tuple(contacts))


def relative_yaws(contacts: Sequence[PlannedContact]) -> NDArray[np.int64]:
    """Class (n,) of the base's yaw relative to the gripper's: 0 for the same, 15° each, from -12 to 11."""
    turns = [entry.contact.base[2] - entry.contact.yaw for entry in contacts]
    classes = np.round(np.array(turns, dtype=float) / (2 * np.pi / BINS)).astype(np.int64)
    return (classes + BINS // 2) % BINS - BINS // 2


def entropy(classes: NDArray[np.int64]) -> float:
    """Entropy [bit] of the distribution of classes (n,)."""
    shares = np.unique(classes, return_counts=True)[1] / max(len(classes), 1)
    return float(-(shares * np.log2(shares)).sum() + 0.0)


def clusters(contacts: Sequence[PlannedContact]) -> list[int]:
    """Sizes of clusters of arm configurations, the largest first.

    One after the other, a configuration that differs from the first one of every cluster by more than
    `_SAME_CONFIGURATION` in some joint of the arm begins a new cluster. Whole turns do not count.
    """
    first: list[Array] = []
    sizes: list[int] = []
    for entry in contacts:
        for number, other in enumerate(first):
            away = np.remainder(entry.q[1:] - other[1:] + np.pi, 2 * np.pi) - np.pi
            if np.abs(away).max() <= _SAME_CONFIGURATION:
                sizes[number] += 1
                break
        else:
            first.append(entry.q)
            sizes.append(1)
    return sorted(sizes, reverse=True)


def spread_table(plans: Mapping[str, Sequence[PlannedScene]]) -> str:
    """The figures of every kind of plan side by side, as Markdown; averages are over scenes that all kinds solve."""
    solved = [{plan.seed for plan in some if plan.clearances is not None} for some in plans.values()]
    common = set.intersection(*solved)
    rows = []
    for name, some in plans.items():
        chosen = [plan for plan in some if plan.seed in common]
        contacts = [contact for plan in some for contact in plan.contacts]
        beyond = [p.clearances - p.floor for p in chosen if p.clearances is not None and p.floor is not None]
        sizes = clusters(contacts)
        row = {
            "plans": name,
            "solved": f"{sum(plan.clearances is not None for plan in some)} of {len(some)}",
            "clearances": f"{np.mean([plan.clearances or 0 for plan in chosen]):.2f}",
            "clearances - lower bound": f"{np.mean(beyond):+.2f}",
            "simulated time [s]": f"{np.mean([plan.duration for plan in chosen]):.1f}",
            "planning [CPU s]": f"{np.mean([plan.planning_s for plan in some]):.2f}",
            "straight contacts": f"{sum(entry.contact.is_straight for entry in contacts)} of {len(contacts)}",
            "entropy of base yaw - gripper yaw [bit]": f"{entropy(relative_yaws(contacts)):.2f}",
            "clusters of arm configurations": f"{len(sizes)} (largest {sizes[0] / max(len(contacts), 1):.0%})",
        }
        rows.append(row)
    return markdown_table(list(rows[0]), [list(row.values()) for row in rows])


def plot_spread(plans: Mapping[str, Sequence[PlannedScene]], file: Path) -> None:
    """Base yaws relative to the gripper, and the share of contacts in the largest clusters of arm configurations."""
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    width = 0.8 / len(plans)
    for number, (name, some) in enumerate(plans.items()):
        contacts = [contact for plan in some for contact in plan.contacts]
        yaws, sizes = relative_yaws(contacts), np.array(clusters(contacts))
        classes = np.arange(-BINS // 2, BINS // 2)
        shares = np.array([(yaws == one).mean() for one in classes])
        shift = (number - (len(plans) - 1) / 2) * width
        left.bar((classes + shift) * 360 / BINS, shares, width * 360 / BINS, label=f"{name}: {entropy(yaws):.2f} bit")
        right.plot(np.arange(1, len(sizes) + 1), np.cumsum(sizes) / sizes.sum(), "o-", ms=3, label=name)
    left.set(title="base yaw - gripper yaw [°]", ylabel="share of contacts")
    right.set(
        title="contacts in the k largest clusters of arm configurations", xlabel="k", xscale="log", ylim=(0, 1.02)
    )
    for axis in (left, right):
        axis.grid(alpha=0.3)
        axis.legend()
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
