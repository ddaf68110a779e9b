"""Two-level policies with learned levels: weights of the package, or of training runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from clutter_env.policies.high_level.policy import LearnedHighLevelPolicy
from clutter_env.policies.motion.keyframe_policy import KeyframePolicy
from clutter_env.policies.planned import PlannedHighLevelPolicy, PlannedMotionPolicy
from clutter_env.policies.protocol import PolicyError
from clutter_env.policies.runs import DECISION_LEARNERS, DECISIONS_FILE, MOTION_LEARNERS, MOTIONS_FILE, load_run
from clutter_env.policies.two_level import TwoLevelPolicy
from clutter_env.policies.weights import shipped_path
from planners import find_grasp_set


def shipped_policy(levels: str, problem: str) -> TwoLevelPolicy:
    """A policy with the weights of the package.

    Args:
        levels: "keyframes" (both levels learned), "planned-decisions" or "planned-motions" (that level is planned).
        problem: "side" (level grasps), "all" (all grasps) or "shelf" (level grasps, under the shelf's board).
    """
    return join_levels(
        None if levels == "planned-decisions" else LearnedHighLevelPolicy.load(shipped_path("decisions", problem)),
        None if levels == "planned-motions" else KeyframePolicy.load(shipped_path("motions", problem)),
    )


def two_level_policy(directories: Sequence[Path]) -> TwoLevelPolicy:
    """The policy of a run that learned decisions, of one that learned motions, or of both.

    Raises:
        PolicyError: another combination of runs, or weights for different robots, layouts or grasps.
    """
    algorithms = [str(load_run(directory)["algorithm"]) for directory in directories]
    runs = list(zip(algorithms, directories, strict=True))
    decisions = [directory for algorithm, directory in runs if algorithm in DECISION_LEARNERS]
    motions = [directory for algorithm, directory in runs if algorithm in MOTION_LEARNERS]
    if len(decisions) > 1 or len(motions) > 1 or len(decisions) + len(motions) != len(runs):
        raise PolicyError(
            f"runs of {' and '.join(algorithms)} are no policy of two levels; join one of "
            f"{', '.join(DECISION_LEARNERS)} and one of {', '.join(MOTION_LEARNERS)}"
        )
    return join_levels(
        LearnedHighLevelPolicy.load(decisions[0] / DECISIONS_FILE) if decisions else None,
        KeyframePolicy.load(motions[0] / MOTIONS_FILE) if motions else None,
    )


def join_levels(decisions: LearnedHighLevelPolicy | None, motions: KeyframePolicy | None) -> TwoLevelPolicy:
    """A policy of two levels; what is not learned is planned, decisions with the grasps of the learned motions.

    Raises:
        PolicyError: the weights are for different robots or layouts, or motions for fewer grasps than the decisions.
    """
    if decisions is None:
        grasps = "side" if motions is None else motions.info.grasps
        high_level = PlannedHighLevelPolicy(grasps)
        return TwoLevelPolicy(high_level, motions or PlannedMotionPolicy(), "side" if grasps == "side" else "all")
    grasps = decisions.info.grasps
    if motions is not None:
        one, other = decisions.info, motions.info
        same = (one.robot, one.layout) == (other.robot, other.layout)
        if not same or not set(find_grasp_set(one.grasps)) <= set(find_grasp_set(other.grasps)):
            raise PolicyError(
                f"decisions for {one.robot}, layout {one.layout!r}, grasps {one.grasps!r} do not fit motions for "
                f"{other.robot}, layout {other.layout!r}, grasps {other.grasps!r}"
            )
    return TwoLevelPolicy(decisions, motions or PlannedMotionPolicy(), "side" if grasps == "side" else "all")
