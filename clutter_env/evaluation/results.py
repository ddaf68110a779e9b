"""The content of the results file of one policy on one set of scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from clutter_env.evaluation.evaluate import Evaluation
from clutter_env.evaluation.score import Score
from clutter_env.evaluation.tables import STRATA, stratum
from clutter_env.reporting.intervals import wilson
from clutter_env.suites import Floor, content_digest, suite

FORMAT = 3


def results(evaluation: Evaluation, floors: Sequence[Floor] = ()) -> dict[str, Any]:
    """JSON values of an evaluation.

    `digest` covers the scenes, the policy's name, the environment and the episodes, but no wall times: equal digests
    mean equal results.

    Args:
        evaluation: of a policy.
        floors: minimum numbers of clearances of its scenes, see `minimum_clearances`; empty where they are not known.
    """
    scenes, scores = evaluation.scenes, evaluation.scores
    counts = [floor.count for floor in floors] or [None] * len(scores)
    played = {
        "scenes": scenes.name,
        "suite": scenes.suite,
        "suite_sha256": suite(scenes.suite).digest if scenes.suite else "",
        "split": scenes.split,
        "policy": evaluation.policy,
        "seed": evaluation.seed,
        "feasibility": evaluation.feasibility,
        "grasps": evaluation.grasps,
        "environment": evaluation.provenance["environment"],
        "episodes": [
            {"index": index, "floor": count, **{k: v for k, v in asdict(score).items() if k != "wall_s"}}
            for index, (score, count) in enumerate(zip(scores, counts, strict=True))
        ],
    }
    groups = {
        name: [score for score, floor in zip(scores, floors, strict=True) if stratum(floor) == name]
        for name in STRATA
        if floors
    }
    means = ("steps", "sim_s", "moved", "cleared", "disturbed", "fallen", "refused")
    return {
        "format": FORMAT,
        "provenance": evaluation.provenance,
        "digest": content_digest(played),
        "summary": {
            **_rates(scores),
            "crashes": evaluation.crashes,
            "by_floor": {name: _rates(group) for name, group in groups.items() if group},
            "mean": {name: float(np.mean([getattr(score, name) for score in scores])) for name in means},
        },
        **played,
        "wall_s": [score.wall_s for score in scores],
    }


def _rates(scores: Sequence[Score]) -> dict[str, Any]:
    """Success rates with Wilson's 95% intervals."""
    count = len(scores)
    clean, lifted = (sum(getattr(score, name) for score in scores) for name in ("clean", "lifted"))
    return {
        "episodes": count,
        "clean": {"successes": clean, **wilson(clean, count)._asdict()},
        "lifted": {"successes": lifted, **wilson(lifted, count)._asdict()},
    }
