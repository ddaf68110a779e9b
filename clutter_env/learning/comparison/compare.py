"""A comparison: which policy plays which scene, the results kept in a file, and one row of the table per policy."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from clutter_env.errors import SuiteError
from clutter_env.learning.comparison.evaluation import Score
from clutter_env.learning.comparison.jobs import FLOOR, EvaluationJob, Result, WrongScene, failed_episode, run_job
from clutter_env.learning.comparison.records import ResultRecords
from clutter_env.learning.comparison.run_names import run_names, run_task
from clutter_env.learning.comparison.scene_sets import SceneSet
from clutter_env.learning.comparison.suite_policies import env_keywords, load_policy, policy_families, policy_grasps
from clutter_env.learning.comparison.tables import Row, summarise
from clutter_env.learning.errors import LearningError
from clutter_env.parallel import Crash, Killed
from clutter_env.suites import Floor

__all__ = ["CONTROLS", "Comparison", "EvaluationRunner", "evaluate_all", "make_jobs", "make_rows"]

CONTROLS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"retrieve": ("greedy", "random-skills", "bulldozer"), "reach": ("random",), "pick": ("random",)}
)
"""Policies without training that play in every comparison, by the family of the environment."""


@dataclass(frozen=True)
class Comparison:
    """What is compared.

    Attributes:
        scene_sets: every policy plays those of them that it can play.
        policies: names for `load_policy`; `CONTROLS` play in any case.
        runs: directories of training runs; each plays the sets of its family with as many objects.
        seed: of the built-in random policies and of the bootstrap.
        feasibility: of the Skill environment, for policies that act by skills.
    """

    scene_sets: Sequence[SceneSet]
    policies: Sequence[str] = ()
    runs: Sequence[Path] = ()
    seed: int = 0
    feasibility: str = "oracle"

    def contenders(self, scenes: SceneSet) -> list[str]:
        """The policies that play a set of scenes: those asked for, the runs, the controls.

        Raises:
            LearningError: there is no such policy, or a directory holds no training run.
        """
        named = [name for name in self.policies if scenes.family in policy_families(name)]
        runs = [str(run) for run in self.runs if _fits(run, scenes)]
        return list(dict.fromkeys((*named, *runs, *CONTROLS[scenes.family])))

    def grasps(self, policy: str) -> str:
        """The grasps by whose floors the results of a policy are broken down."""
        return policy_grasps(load_policy(policy, self.seed))


class EvaluationRunner(Protocol):
    """Runs `run_job` on jobs in parallel: `run_jobs` with its number of workers chosen."""

    def __call__(
        self, function: Callable[[EvaluationJob], Result | WrongScene], jobs: Iterable[EvaluationJob]
    ) -> Iterator[tuple[EvaluationJob, Result | WrongScene | Crash | Killed]]:
        """Pairs of job and result; see `run_jobs`."""
        ...


def make_jobs(comparison: Comparison) -> list[EvaluationJob]:
    """Every policy on every scene that it can play, and the minimum numbers of clearances of all Retrieve scenes.

    Raises:
        LearningError: an unknown policy, with the known ones; a directory without a training run; a policy or run that
            plays none of the scenes.
        SuiteError: no such suite or split.
    """
    jobs = []
    playing: set[str] = set()
    for name in comparison.policies:
        env_keywords(load_policy(name, comparison.seed))
    for scenes in comparison.scene_sets:
        contenders = comparison.contenders(scenes)
        playing |= set(contenders)
        is_retrieval = scenes.family == "retrieve"
        floors = sorted({FLOOR + comparison.grasps(policy) for policy in contenders}) if is_retrieval else []
        for policy in (*floors, *contenders):
            jobs += [
                EvaluationJob(scenes, index, policy, comparison.seed, comparison.feasibility)
                for index in range(len(scenes.scenes))
            ]
    idle = [name for name in (*comparison.policies, *map(str, comparison.runs)) if name not in playing]
    if idle:
        sets = ", ".join(scenes.name for scenes in comparison.scene_sets)
        raise LearningError(f"{', '.join(idle)} cannot play any of these scenes: {sets}")
    return jobs


def evaluate_all(
    jobs: Sequence[EvaluationJob],
    records: ResultRecords,
    run: EvaluationRunner,
    report: Callable[[int], None] = lambda _: None,
) -> dict[EvaluationJob, Result]:
    """The results of all jobs; each is written to the file at once, and those that are in it are not made again.

    A policy that raises an exception loses the episode; such results are not written, so that they are made again.

    Args:
        jobs: from `make_jobs`.
        records: the file.
        run: for example `partial(run_jobs, workers=2)`.
        report: called with the number of results, first with that in the file.

    Raises:
        LearningError: a worker died, or a floor could not be found.
        SuiteError: a scene is not the one that the suite was made with.
    """
    known = {job: records.get(job) for job in jobs}
    results = {job: result for job, result in known.items() if result is not None}
    report(len(results))
    for job, result in run(run_job, [job for job in jobs if job not in results]):
        if isinstance(result, WrongScene):
            raise SuiteError(result.message)
        if isinstance(result, Crash | Killed):
            lost = None if job.policy.startswith(FLOOR) else failed_episode(job, result)
            if lost is None:
                raise LearningError(f"{job.policy} on scene {job.index} of {job.scenes.name}: {_text(result)}")
            results[job] = lost
        else:
            records.add(job, result)
            results[job] = result
        report(len(results))
    return results


def make_rows(comparison: Comparison, results: Mapping[EvaluationJob, Result]) -> list[Row]:
    """One row per set of scenes and policy; runs, and pairs of runs, that differ in their seeds alone form one row."""
    rows = []
    for scenes in comparison.scene_sets:
        own = {(job.policy, job.index): result for job, result in results.items() if job.scenes == scenes}
        contenders = comparison.contenders(scenes)
        names = {policy: policy for policy in contenders} | run_names(contenders)
        groups: dict[str, list[str]] = {}
        for policy in contenders:
            groups.setdefault(names[policy], []).append(policy)
        for name, policies in groups.items():
            runs = [[score for score in _column(own, policy) if isinstance(score, Score)] for policy in policies]
            floors = _column(own, FLOOR + comparison.grasps(policies[0]))
            by_seed = {
                scene.seed: floor
                for scene, floor in zip(scenes.scenes, floors, strict=False)
                if isinstance(floor, Floor)
            }
            rows.append(summarise(scenes.name, name, runs, by_seed, comparison.seed))
    return rows


def _column(results: Mapping[tuple[str, int], Result], policy: str) -> list[Result]:
    """The results of one policy, or the floors, in the order of the scenes."""
    return [result for (name, _), result in sorted(results.items(), key=lambda entry: entry[0]) if name == policy]


def _fits(directory: Path, scenes: SceneSet) -> bool:
    """Whether a training run can play scenes: those of its family with as many objects."""
    task = run_task(directory)
    return scenes.family in policy_families(str(directory)) and task.num_objects == scenes.num_objects


def _text(problem: Crash | Killed) -> str:
    return problem.detail if isinstance(problem, Crash) else f"killed after {problem.seconds:.0f} s"
