"""Evaluations made of scores, without an episode."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clutter_env.evaluation.evaluate import Evaluation, Played
from clutter_env.evaluation.recording import Recording
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.score import Score
from clutter_env.policies.registry import PolicyTraits
from clutter_env.suites import Floor

IDLE = Recording("joint", np.zeros((1, 12), np.float32))


def score(seed: int, moved: int | None, *, is_lifted: bool = False) -> Score:
    """A solved scene, or with None an unsolved one."""
    solved = moved is not None
    failure = "" if solved else "time limit"
    pressed = (0.0, 0.0, 0.0, 0.0, 0.0)
    count = moved or 0
    return Score(seed, solved, solved or is_lifted, 1, 5.0, count, count, 0, 0, *pressed, 0.0, 0, 0, failure, 1.0)


def evaluation(scores: Sequence[Score], floors: Sequence[Floor], scenes: SceneSet, policy: str = "ngr") -> Evaluation:
    """The evaluation of a privileged policy with level grasps that has these scores."""
    return Evaluation(
        policy=policy,
        scenes=scenes,
        seed=0,
        feasibility="oracle",
        traits=PolicyTraits("privileged", {}, False, "side", "Ngr", ""),
        weights={},
        episodes=tuple(Played(one, IDLE) for one in scores),
        floors=tuple(floors),
        provenance={"version": "0.2.0", "commit": None, "mujoco": "3", "environment": {}},
        judged_in={},
    )
