"""`evaluate(policy, scenes)`: episodes of a policy on fixed scenes, and their scores.

The commands `evaluate` and `compare` print its results; an interrupted evaluation goes on with its file of records.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypeVar

import gymnasium as gym

from clutter_env.errors import ClutterEnvError, LearningError, SuiteError
from clutter_env.evaluation.scenes import Scene, SceneSet, find_floor, skill_scene
from clutter_env.evaluation.score import PolicyCrashed, Score, play_scene
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.policies.protocol import AnyPolicy, PolicyError
from clutter_env.policies.registry import acts_by_skills, env_keywords, load_policy, policy_grasps
from clutter_env.policies.runs import load_run, run_directories
from clutter_env.provenance import differences, provenance
from clutter_env.reporting.files import JsonLines
from clutter_env.suites import Floor, suite
from clutter_env.task import Task

ResultT = TypeVar("ResultT", Score, Floor)
_HINT = "--count-crashes counts such episodes as failures"


@dataclass(frozen=True)
class Evaluation:
    """The result of `evaluate`.

    Attributes:
        policy: its name.
        scenes: the scenes that it played.
        seed: of the built-in random policies.
        feasibility: of the Skill environment, for policies that act by skills.
        grasps: "side" or "all", by whose lower bounds its results are broken down.
        scores: of the scenes, in their order.
        floors: lower bounds of the scenes for these grasps; empty where they are not known, as outside the suites.
        provenance: version, commit, packages and digest of the environment; see `clutter_env.provenance`.
    """

    policy: str
    scenes: SceneSet
    seed: int
    feasibility: str
    grasps: str
    scores: tuple[Score, ...]
    floors: tuple[Floor, ...]
    provenance: Mapping[str, Any]


@dataclass(frozen=True)
class _Job:
    """The policy and the scenes of a worker's jobs, one for each index of a scene."""

    policy: str
    scenes: SceneSet
    seed: int = 0
    feasibility: str = ""

    def scene(self, index: int, policy: AnyPolicy) -> Scene:
        scene = self.scenes.scenes[index]
        return skill_scene(scene, self.feasibility) if acts_by_skills(policy) else scene

    def make_env(self, policy: AnyPolicy) -> gym.Env[Any, Any]:
        """The environment of all its scenes."""
        return self.scene(0, policy).make(**env_keywords(policy))

    def place(self, index: int) -> str:
        return f"{self.policy} on scene {index} of {self.scenes.name} (seed {self.scenes.scenes[index].seed})"


def evaluate(
    policy: str | AnyPolicy,
    scenes: SceneSet,
    *,
    seed: int = 0,
    feasibility: str = "oracle",
    workers: int = 1,
    ray: str = "",
    count_crashes: bool = False,
    records: ResultRecords | None = None,
    tick: Callable[[], object] = lambda: None,
) -> Evaluation:
    """Play all scenes with a policy.

    Args:
        policy: a name for `load_policy`, or a policy, which plays in this process.
        scenes: to be played.
        seed: of the built-in random policies.
        feasibility: of the Skill environment, for policies that act by skills: "oracle" or "none".
        workers: number of processes; with one of them the scenes are played in this process.
        ray: address of Ray; "" for processes of this machine.
        count_crashes: an exception of the policy is a failed episode; otherwise it ends the evaluation.
        records: file to which every score is written at once; those that are in it are not made again.
        tick: called after every episode.

    Raises:
        SuiteError: no such suite or split, or a scene is not the one that the suite was made with.
        PolicyError: no such policy, or it cannot play these scenes.
        PolicyCrashed: the policy raised an exception in another process, which died, or returned no valid action; an
            exception in this process is not caught.
        OSError: the scores cannot be written; those written before stay.
    """
    name = policy if isinstance(policy, str) else type(policy).__name__
    playing = load_policy(policy, seed) if isinstance(policy, str) else policy
    grasps, job = policy_grasps(playing), _Job(name, scenes, seed, feasibility)
    floors = lower_bounds(scenes, grasps) if scenes.suite else ()
    env = job.make_env(playing)

    def play(missing: Iterable[int]) -> Iterator[tuple[int, Score]]:
        if (workers == 1 and not ray) or not isinstance(policy, str):
            yield from ((index, _play_here(job, index, env, playing, count_crashes)) for index in missing)
            return
        for index, result in run_jobs(partial(_play_in_worker, job), missing, workers, ray=ray):
            if isinstance(result, ClutterEnvError):
                raise result
            if isinstance(result, Crash) and result.is_final and count_crashes:
                result = Score.of_crash(scenes.scenes[index].seed, result.summary)
            elif isinstance(result, Crash | Killed):
                hint = f"; {_HINT}" if isinstance(result, Crash) and result.is_final else ""
                raise PolicyCrashed(f"{job.place(index)}{hint}\n\n{_text(result)}")
            yield index, result

    try:
        made_with = provenance(env)
        scores = _complete(job, made_with, records, play, tick)
    finally:
        env.close()
    return Evaluation(name, scenes, seed, feasibility, grasps, tuple(scores), floors, made_with)


def lower_bounds(
    scenes: SceneSet, grasps: str, *, workers: int = 1, ray: str = "", records: ResultRecords | None = None
) -> tuple[Floor, ...]:
    """The lower bound of every scene, the fewest clearances: that of the suite, or found by the planner.

    Raises:
        SuiteError: the suite has none for these grasps.
        LearningError: the planner failed.
    """

    def find(missing: Iterable[int]) -> Iterator[tuple[int, Floor]]:
        for index, result in run_jobs(partial(_find_floor, scenes, grasps), missing, workers, ray=ray):
            if isinstance(result, Crash | Killed):
                raise LearningError(f"lower bound of scene {index} of {scenes.name}: {_text(result)}")
            yield index, result

    if scenes.suite:
        return tuple(find_floor(scene, grasps) for scene in scenes.scenes)
    made_with = Task(scenes.env_id, scenes.scenes[0].keywords).provenance()
    return tuple(_complete(_Job(f"minimum for {grasps}", scenes), made_with, records, find))


def _complete(
    job: _Job,
    made_with: Mapping[str, Any],
    records: ResultRecords | None,
    make: Callable[[Iterable[int]], Iterator[tuple[int, ResultT]]],
    tick: Callable[[], object] = lambda: None,
) -> list[ResultT]:
    """The results of all scenes: those in the records, and those that `make` makes of the others' indices.

    A result is written as soon as it is made, but for a crash: the policy will have been mended.
    """
    count, found, keys = len(job.scenes.scenes), {}, []
    for index in range(count):
        keys.append(_key(job, index, made_with))
        if records is not None and (known := records.get(keys[index])) is not None:
            found[index] = known
            tick()
    for index, result in make([index for index in range(count) if index not in found]):
        if records is not None and not (isinstance(result, Score) and result.is_crash):
            records.add(keys[index], result)
        found[index] = result
        tick()
    return [found[index] for index in range(count)]


def _play_here(job: _Job, index: int, env: gym.Env, policy: AnyPolicy, count_crashes: bool) -> Score:
    scene = job.scene(index, policy)
    try:
        return play_scene(scene, env, policy)
    except (SuiteError, PolicyError):
        raise
    except Exception as problem:
        if not count_crashes:
            problem.add_note(f"{job.place(index)}; {_HINT}")
            raise  # with the traceback of the policy's own code
        return Score.of_crash(scene.seed, f"{type(problem).__name__}: {problem}")


@lru_cache(maxsize=2)
def _env_and_policy(job: _Job) -> tuple[gym.Env[Any, Any], AnyPolicy]:
    """Made once in a worker for all scenes of a set, which have the same environment."""
    policy = load_policy(job.policy, job.seed)
    return job.make_env(policy), policy


def _play_in_worker(job: _Job, index: int) -> Score | ClutterEnvError:
    env, policy = _env_and_policy(job)
    try:
        return play_scene(job.scene(index, policy), env, policy)
    except (SuiteError, PolicyError) as problem:
        return problem


def _find_floor(scenes: SceneSet, grasps: str, index: int) -> Floor:
    return find_floor(scenes.scenes[index], grasps)


def _text(problem: Crash | Killed) -> str:
    return problem.detail if isinstance(problem, Crash) else f"killed after {problem.seconds:.0f} s"


class ResultRecords:
    """The scores in a file, one line per policy and scene; those made so far are found again.

    Raises:
        LearningError: the file is damaged, holds something else, or its scores were made with another version; the
            message says what differs.
    """

    def __init__(self, path: Path) -> None:
        self._known: dict[str, Any] = {}
        try:
            self._file = JsonLines(path)
            header, *rows = self._file.values or [{"provenance": provenance()}]
            made_with = header.get("provenance")
            for row in rows:
                values = row["result"]
                self._known[row["key"]] = Score(**values) if "clean" in values else Floor(**values)
        except (ValueError, KeyError, TypeError, AttributeError) as problem:
            raise LearningError(f"{path} holds no scores of this package, or it is damaged: {problem!r}") from problem
        if changed := differences(made_with, provenance()):
            raise LearningError(f"{path} cannot be continued. {' '.join(changed)} Choose another --out.")
        if not self._file.values:
            self._file.append(header)

    def get(self, key: str) -> Any:
        """The `Score` or `Floor` of a key, None if it has not been made."""
        return self._known.get(key)

    def add(self, key: str, result: Score | Floor) -> None:
        """Add a result, and write it to the disk.

        Raises:
            OSError: the disk is full or cannot be written; what was written before stays.
        """
        self._file.append({"key": key, "result": result})
        self._known[key] = result


def _key(job: _Job, index: int, made_with: Mapping[str, Any]) -> str:
    """Identify a result; a run that was trained further, or a changed suite or environment, is played again."""
    scenes = job.scenes
    where = f"{scenes.suite} {suite(scenes.suite).digest} {scenes.split}" if scenes.suite else scenes.env_id
    if not scenes.suite:
        where += f" {scenes.layout} {scenes.obstructed} from {scenes.first_seed}"
    steps = "".join(f" after {load_run(run)['steps']}" for run in run_directories(job.policy))
    environment = hashlib.sha256(json.dumps(made_with["environment"], sort_keys=True).encode()).hexdigest()[:16]
    return f"{where} {index}: {job.policy}{steps}, seed {job.seed}, {job.feasibility}, environment {environment}"
