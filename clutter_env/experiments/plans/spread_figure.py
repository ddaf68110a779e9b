"""How much plans differ from scene to scene, as a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from clutter_env.experiments.plans.spread import BINS, PlannedScene, clusters, entropy, relative_yaws

__all__ = ["plot_spread"]


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
