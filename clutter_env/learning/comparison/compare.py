"""A comparison: which policy plays which scene, the scores kept in a file, and one row of the table per policy."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeAlias

from clutter_env.learning.comparison.evaluation import Score, held_out_seeds
from clutter_env.learning.comparison.jobs import (
    FLOOR,
    EvaluationJob,
    policy_name,
    run_environment,
    run_job,
    scene_set_name,
)
from clutter_env.learning.comparison.tables import Row, summarise
from clutter_env.learning.demonstrations.experts import expert_names
from clutter_env.learning.errors import LearningError
from clutter_env.learning.policies.baselines import BASELINES
from clutter_env.learning.policies.runs import RUN_FILE, load_run
from clutter_env.parallel.jobs import Crash, Killed
from clutter_env.reporting.json_file import write_json

__all__ = ["Comparison", "EvaluationRunner", "Result", "evaluate_all", "make_jobs", "make_rows"]

Result: TypeAlias = Score | int | None
"""Of a policy; or of the minimum number of clearances, None where it is not proved."""


@dataclass(frozen=True)
class Comparison:
    """What is compared.

    Attributes:
        envs: environment ids; policies that act by skills play the scenes of the Retrieve environment with as many
            objects.
        policies: strategies of the planner, "scripted", "random", "greedy"; each plays all environments.
        runs: directories of training runs; each plays the environments whose scenes it was trained on.
        scenes: number of held-out scenes.
        max_steps: after which an episode of low-level actions is cut off.
        seed: of the bootstrap.
    """

    envs: Sequence[str]
    policies: Sequence[str]
    runs: Sequence[Path] = ()
    scenes: int = 50
    max_steps: int | None = 1500
    seed: int = 0


class EvaluationRunner(Protocol):
    """Runs `run_job` on jobs in parallel: `run_jobs` with its number of workers chosen."""

    def __call__(
        self, function: Callable[[EvaluationJob], Result], jobs: Iterable[EvaluationJob]
    ) -> Iterator[tuple[EvaluationJob, Result | Crash | Killed]]:
        """Pairs of job and result; see `run_jobs`."""
        ...


def make_jobs(comparison: Comparison) -> list[EvaluationJob]:
    """Every policy on every scene that it can play, and the minimum number of clearances of every Retrieve scene.

    Raises:
        LearningError: an unknown policy, with the known ones; a directory without a training run.
    """
    jobs = []
    for env_id in comparison.envs:
        known = (*expert_names(env_id), *BASELINES)
        for name in comparison.policies:
            if name not in known:
                raise LearningError(f"no policy {name!r} for {env_id}; known ones: {', '.join(known)}, and runs")
        scenes = scene_set_name(env_id)
        runs = [str(run) for run in comparison.runs if scene_set_name(run_environment(run)) == scenes]
        floors = (FLOOR,) if "/Retrieve" in env_id else ()
        for policy in (*floors, *comparison.policies, *runs):
            seeds = held_out_seeds(comparison.scenes)
            jobs += [EvaluationJob(env_id, policy, seed, comparison.max_steps) for seed in seeds]
    return jobs


def evaluate_all(
    jobs: Sequence[EvaluationJob], path: Path, run: EvaluationRunner, report: Callable[[int], None] = lambda _: None
) -> dict[EvaluationJob, Result]:
    """The results of all jobs; each is written to a JSON file at once, and those that are in it are not made again.

    Args:
        jobs: from `make_jobs`.
        path: of the JSON file.
        run: for example `partial(run_jobs, workers=2)`.
        report: called with the number of results, first with that in the file.

    Raises:
        LearningError: a job raised, or its worker died.
    """
    known: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    keys = {job: _key(job) for job in jobs}
    missing = [job for job in jobs if keys[job] not in known]
    report(len(jobs) - len(missing))
    for count, (job, result) in enumerate(run(run_job, missing), start=len(jobs) - len(missing) + 1):
        if isinstance(result, Crash | Killed):
            detail = result.detail if isinstance(result, Crash) else f"killed after {result.seconds:.0f} s"
            raise LearningError(f"{job.policy} on {job.env_id}, seed {job.seed}: {detail}")
        known[keys[job]] = result
        write_json(path, known)
        report(count)
    return {job: _restored(known[keys[job]]) for job in jobs}


def make_rows(comparison: Comparison, results: Mapping[EvaluationJob, Result]) -> list[Row]:
    """One row per environment and policy; runs that differ in their seed alone form one row."""
    rows = []
    for env_id in comparison.envs:
        own = {job: result for job, result in results.items() if job.env_id == env_id}
        floors = {
            job.seed: result for job, result in own.items() if job.policy == FLOOR and not isinstance(result, Score)
        }
        groups: dict[str, dict[str, list[Score]]] = {}
        for job, result in own.items():
            if isinstance(result, Score):
                runs = groups.setdefault(policy_name(job.policy), {})
                runs.setdefault(job.policy, []).append(result)
        for name, by_run in groups.items():
            rows.append(summarise(scene_set_name(env_id), name, list(by_run.values()), floors, comparison.seed))
    return rows


def _key(job: EvaluationJob) -> str:
    """Identifies a job in the file of scores; a run that was trained further is evaluated again."""
    is_run = (Path(job.policy) / RUN_FILE).exists()
    steps = f" after {load_run(Path(job.policy))['steps']}" if is_run else ""
    return f"{job.env_id} {job.policy}{steps} {job.seed} {job.max_steps}"


def _restored(value: Any) -> Result:
    """A result as it was made, or read back from JSON."""
    return Score(**value) if isinstance(value, dict) else value
