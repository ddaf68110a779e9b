"""Examples from the states that a learner comes into, labelled by the planner's geometry (DAgger, Ross et al. 2011).

Choosing the best of many contacts finds those that the network is wrong about. Here the learner acts, without physics,
and the planner says about every state that it decided in what was free there; the contacts chosen are among them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clutter_env.learning.decisions.contact_rule import ContactRule
from clutter_env.learning.decisions.examples import ContactExamples, pick_examples, place_examples, random_points
from clutter_env.learning.decisions.kinematic import Chooser, KinematicOutcome, placed_body, simulate_decisions
from planners import Scene

__all__ = ["Visited", "visit"]


@dataclass(frozen=True)
class Visited:
    """What a learner did in some scenes.

    Attributes:
        examples: from the states in which it decided; None if there were none.
        outcomes: of the episodes.
    """

    examples: ContactExamples | None
    outcomes: tuple[KinematicOutcome, ...]


def visit(
    chooser: Chooser, starts: Sequence[tuple[Scene, str]], rule: ContactRule, rng: np.random.Generator
) -> Visited:
    """Let a learner act.

    Args:
        chooser: the learner.
        starts: scenes, and the names of their targets.
        rule: the contacts that are labelled.
        rng: for more places beside those that it chose.
    """
    outcomes = [simulate_decisions(chooser, scene, target) for scene, target in starts]
    parts = [part for outcome in outcomes for part in _labelled(outcome, rule, rng)]
    return Visited(ContactExamples.joined(parts) if parts else None, tuple(outcomes))


def _labelled(outcome: KinematicOutcome, rule: ContactRule, rng: np.random.Generator) -> list[ContactExamples]:
    parts = []
    for scene, contact in zip(outcome.scenes, outcome.contacts, strict=True):
        if scene.held is None:
            parts.append(pick_examples(scene, rule, rng))
        else:
            body = placed_body(scene, contact)
            points = np.concatenate((body.foot[None], random_points(scene, body.radius, rng)))
            parts.append(place_examples(scene, rule, points, rng))
    return parts
