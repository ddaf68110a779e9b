"""Policies of two levels whose weights come with the package, in the protocol of `clutter-env evaluate`.

clutter-env evaluate --suite side-15-v1 --policy keyframes
"""

from __future__ import annotations

import assets
from clutter_env.learning.comparison.decision_policies import learned_decider
from clutter_env.learning.contacts.hierarchical import HierarchicalPolicy
from clutter_env.learning.contacts.planned_decider import PlannedDecider
from clutter_env.learning.contacts.protocols import Mover
from clutter_env.learning.keyframes.mover import KeyframeMover

__all__ = ["keyframes", "learned_mover", "planned_decisions"]


def learned_mover(grasps: str) -> KeyframeMover:
    """The mover whose weights are shipped, for a grasp set.

    Raises:
        FileNotFoundError: there are no weights for this grasp set.
    """
    return KeyframeMover.load(assets.path(f"policies/keyframes-{grasps}.npz"))


def keyframes() -> HierarchicalPolicy:
    """Learned decisions and learned motions with level grasps: nothing but observations is read."""
    return HierarchicalPolicy(learned_decider("side"), learned_mover("side"), "side")


def planned_decisions(mover: Mover | None = None) -> HierarchicalPolicy:
    """Decisions of the canonical expert with level grasps, brought about by learned motions, the shipped ones if none
    are given."""
    return HierarchicalPolicy(PlannedDecider("side"), mover or learned_mover("side"), "side")
