"""Policies of two levels whose weights come with the package, in the protocol of `clutter-env evaluate`.

clutter-env evaluate --suite side-15-v1 --policy keyframes
clutter-env evaluate --suite all-25-v1 --policy keyframes-all
clutter-env evaluate --suite shelf-10-v2 --policy keyframes-shelf
"""

from __future__ import annotations

import assets
from clutter_env.learning.comparison.decision_policies import learned_decider
from clutter_env.learning.contacts.hierarchical import HierarchicalPolicy
from clutter_env.learning.contacts.planned_decider import PlannedDecider
from clutter_env.learning.contacts.protocols import Mover
from clutter_env.learning.keyframes.mover import KeyframeMover

__all__ = [
    "keyframes",
    "keyframes_all",
    "keyframes_shelf",
    "learned_mover",
    "planned_decisions",
    "planned_decisions_all",
    "planned_decisions_shelf",
]


def learned_mover(problem: str) -> KeyframeMover:
    """The mover whose weights are shipped for a problem: "side", "all" or "shelf".

    Raises:
        FileNotFoundError: there are no weights for this problem; the message lists the files that exist.
    """
    return KeyframeMover.load(assets.path(f"policies/keyframes-{problem}.npz"))


def keyframes() -> HierarchicalPolicy:
    """Learned decisions and learned motions with level grasps: nothing but observations is read."""
    return HierarchicalPolicy(learned_decider("side"), learned_mover("side"), "side")


def keyframes_all() -> HierarchicalPolicy:
    """The same with level and tilted grasps, and those from above."""
    return HierarchicalPolicy(learned_decider("all"), learned_mover("all"), "all")


def keyframes_shelf() -> HierarchicalPolicy:
    """The same with level grasps under the shelf's board."""
    return HierarchicalPolicy(learned_decider("shelf"), learned_mover("shelf"), "side")


def planned_decisions(mover: Mover | None = None, grasps: str = "side") -> HierarchicalPolicy:
    """Decisions of the canonical expert, brought about by learned motions, the shipped ones if none are given."""
    return HierarchicalPolicy(PlannedDecider(grasps), mover or learned_mover(grasps), grasps)


def planned_decisions_all() -> HierarchicalPolicy:
    """The same with all grasps."""
    return planned_decisions(grasps="all")


def planned_decisions_shelf() -> HierarchicalPolicy:
    """The same with level grasps under the shelf's board."""
    return planned_decisions(learned_mover("shelf"))
