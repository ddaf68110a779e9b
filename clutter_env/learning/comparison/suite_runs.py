"""A policy on the scenes of a suite: episodes played in parallel, and the content of the results file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from clutter_env.errors import SuiteError
from clutter_env.learning.comparison.evaluation import Score
from clutter_env.learning.comparison.jobs import EvaluationJob, WrongScene, failed_episode, run_job
from clutter_env.learning.comparison.scene_sets import SceneSet
from clutter_env.learning.comparison.strata import by_stratum
from clutter_env.learning.comparison.suite_policies import env_keywords, load_policy, policy_grasps
from clutter_env.learning.errors import LearningError
from clutter_env.learning.task import versions
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.reporting.intervals import wilson
from clutter_env.suites import Floor, content_digest, suite

__all__ = ["Evaluation", "evaluate", "results"]

FORMAT = 2


@dataclass(frozen=True)
class Evaluation:
    """Which policy plays which scenes.

    Attributes:
        suite: name of the suite.
        policy: name of the policy, see `load_policy`.
        split: "test" or "validation".
        scenes: only the first so many scenes of the split; None for all.
        seed: of the built-in random policies.
        feasibility: of the Skill environment, for policies that act by skills.
    """

    suite: str
    policy: str
    split: str = "test"
    scenes: int | None = None
    seed: int = 0
    feasibility: str = "oracle"

    @property
    def jobs(self) -> list[EvaluationJob]:
        """One for each scene.

        Raises:
            SuiteError: no such suite or split.
            LearningError: fewer than one scene, or more than there are.
        """
        scenes = SceneSet(self.suite, self.split, count=self.scenes)
        every = range(len(scenes.scenes))
        return [EvaluationJob(scenes, index, self.policy, self.seed, self.feasibility) for index in every]


def evaluate(
    evaluation: Evaluation, workers: int = 1, ray: str = "", tick: Callable[[], object] = lambda: None
) -> dict[str, Any]:
    """Play all scenes; the content of the results file, see `results`.

    Args:
        evaluation: which policy plays which scenes.
        workers: number of processes.
        ray: address of Ray; "" for processes of this machine.
        tick: called after every episode.

    Raises:
        SuiteError: no such suite or split, or a scene is not the one that the suite was made with.
        LearningError: no such policy, fewer than one scene, or a worker was killed.
    """
    jobs = evaluation.jobs
    policy = load_policy(evaluation.policy, evaluation.seed)
    env_keywords(policy)
    policy_grasps(policy)
    scores: dict[int, Score] = {}
    for job, result in run_jobs(run_job, jobs, workers, ray=ray):
        score = failed_episode(job, result) if isinstance(result, Crash | Killed) else result
        if isinstance(score, WrongScene):
            raise SuiteError(score.message)
        if not isinstance(score, Score):
            raise LearningError(f"scene {job.index} of suite {evaluation.suite!r}: {result}")
        scores[job.index] = score
        tick()
    return results(evaluation, [score for _, score in sorted(scores.items())])


def results(evaluation: Evaluation, scores: Sequence[Score]) -> dict[str, Any]:
    """What the results file holds, as JSON values; the scores are those of the evaluation's scenes, in their order.

    `digest` covers the suite, the policy's name and the episodes, but no wall times: equal digests mean equal results.
    """
    grasps = policy_grasps(load_policy(evaluation.policy, evaluation.seed))
    scenes = suite(evaluation.suite).split(evaluation.split)[: len(scores)]
    floors = [scene.floor(grasps) for scene in scenes]
    played = {
        "suite": evaluation.suite,
        "suite_sha256": suite(evaluation.suite).digest,
        "split": evaluation.split,
        "policy": evaluation.policy,
        "seed": evaluation.seed,
        "feasibility": evaluation.feasibility,
        "grasps": grasps,
        "episodes": [_episode(*entry) for entry in zip(range(len(scores)), scores, floors, strict=True)],
    }
    return {
        "format": FORMAT,
        "versions": versions(),
        "digest": content_digest(played),
        "summary": _summary(scores, floors),
        **played,
        "wall_s": [score.wall_s for score in scores],
    }


def _episode(index: int, score: Score, floor: Floor) -> dict[str, Any]:
    """One episode in the results file: its score without the wall time."""
    values = asdict(score)
    del values["wall_s"]
    return {"index": index, "floor": floor.count, **values}


def _summary(scores: Sequence[Score], floors: Sequence[Floor]) -> dict[str, Any]:
    """Success rates with Wilson's 95% intervals, over all episodes and by stratum; means over all episodes."""
    names = ("steps", "sim_s", "moved", "cleared", "disturbed", "fallen", "refused")
    return {
        **_rates(scores),
        "by_floor": {name: _rates(group) for name, group in by_stratum(scores, floors).items()},
        "mean": {name: float(np.mean([getattr(score, name) for score in scores])) for name in names},
    }


def _rates(scores: Sequence[Score]) -> dict[str, Any]:
    clean, lifted = (sum(getattr(score, name) for score in scores) for name in ("clean", "lifted"))
    count = len(scores)
    return {
        "episodes": count,
        "clean": {"successes": clean, **wilson(clean, count)._asdict()},
        "lifted": {"successes": lifted, **wilson(lifted, count)._asdict()},
    }
