"""Learned decisions brought about by the planner's motions, in the protocol of `clutter-env evaluate`.

clutter-env evaluate --suite side-15-v1 --policy clutter_env.learning.comparison.decision_policies:side
clutter-env evaluate --suite all-25-v1 --policy clutter_env.learning.comparison.decision_policies:all_grasps
clutter-env evaluate --suite shelf-10-v2 --policy clutter_env.learning.comparison.decision_policies:shelf
"""

from __future__ import annotations

import assets
from clutter_env.learning.contacts.hierarchical import HierarchicalPolicy
from clutter_env.learning.contacts.planned_mover import PlannedMover
from clutter_env.learning.decisions.decider import LearnedDecider

__all__ = ["all_grasps", "learned_decider", "shelf", "side"]


def learned_decider(problem: str) -> LearnedDecider:
    """The decider whose weights are shipped for a problem: "side", "all" or "shelf".

    Raises:
        FileNotFoundError: there are no weights for this problem; the message lists the files that exist.
    """
    return LearnedDecider.load(assets.path(f"policies/decisions-{problem}.npz"))


def side() -> HierarchicalPolicy:
    """Level grasps alone: the paper's problem."""
    return HierarchicalPolicy(learned_decider("side"), PlannedMover(), "side")


def all_grasps() -> HierarchicalPolicy:
    """Level and tilted grasps, and those from above."""
    return HierarchicalPolicy(learned_decider("all"), PlannedMover(), "all")


def shelf() -> HierarchicalPolicy:
    """Level grasps under the shelf's board."""
    return HierarchicalPolicy(learned_decider("shelf"), PlannedMover(), "side")
