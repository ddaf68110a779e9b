"""`evaluate(policy, scenes)`: episodes of a policy on fixed scenes, and their scores.

The commands `evaluate`, `compare` and `play` print its results in three ways; training measures success with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import gymnasium as gym

from clutter_env.errors import ClutterEnvError, LearningError, SuiteError
from clutter_env.evaluation.records import ResultRecords
from clutter_env.evaluation.scenes import Scene, SceneSet, find_floor, skill_scene
from clutter_env.evaluation.score import Score, Watch, play_scene
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.policies.protocol import AnyPolicy, PolicyError
from clutter_env.policies.registry import acts_by_skills, env_keywords, load_policy, policy_grasps
from clutter_env.provenance import provenance
from clutter_env.suites import Floor


class PolicyCrashed(RuntimeError):
    """A policy raised an exception in another process; the message ends with its traceback."""


@dataclass(frozen=True)
class Evaluation:
    """The result of `evaluate`.

    Attributes:
        policy: its name.
        scenes: the scenes that it played.
        seed: of the built-in random policies.
        feasibility: of the Skill environment, for policies that act by skills.
        grasps: "side" or "all", by whose minimum numbers of clearances its results are broken down.
        scores: of the scenes, in their order.
        crashes: number of episodes in which the policy raised an exception.
        provenance: version, commit, packages and digest of the environment; see `clutter_env.provenance`.
    """

    policy: str
    scenes: SceneSet
    seed: int
    feasibility: str
    grasps: str
    scores: tuple[Score, ...]
    crashes: int
    provenance: Mapping[str, Any]


@dataclass(frozen=True)
class _Job:
    """The policy and the scenes of a worker's jobs, one for each index of a scene."""

    policy: str
    scenes: SceneSet
    seed: int
    feasibility: str


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
    watch: Watch | None = None,
    render_mode: str | None = None,
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
        watch: called during the episodes, which are then played in this process.
        render_mode: of the environment, for `watch`; a window stays until its user closes it.

    Raises:
        SuiteError: no such suite or split, or a scene is not the one that the suite was made with.
        PolicyError: no such policy, or it cannot play these scenes.
        LearningError: a worker was killed.
        PolicyCrashed: the policy raised an exception in another process; one raised in this process is not caught.
        OSError: the scores cannot be written; those written before stay.
    """
    name = policy if isinstance(policy, str) else type(policy).__name__
    playing = load_policy(policy, seed) if isinstance(policy, str) else policy
    job = _Job(name, scenes, seed, feasibility)
    env = _make_env(job, playing, render_mode)
    try:
        made_with = provenance(env)
        key = partial(_key, job, made_with)
        found: dict[int, Score] = {}
        for index in range(len(scenes.scenes)):
            if records is not None and isinstance(known := records.get(key(index)), Score):
                found[index] = known
                tick()
        missing = [index for index in range(len(scenes.scenes)) if index not in found]
        crashes = 0
        results: Iterable[tuple[int, Score | ClutterEnvError | Crash | Killed]]
        if (workers == 1 and not ray) or not isinstance(policy, str) or watch is not None:
            results = ((index, _play_here(job, index, env, playing, watch, count_crashes)) for index in missing)
        else:
            results = run_jobs(partial(_play_in_worker, job), missing, workers, ray=ray)
        for index, result in results:
            if isinstance(result, ClutterEnvError):
                raise result
            if isinstance(result, Crash | Killed):
                result = _crashed(job, index, result, count_crashes)
                crashes += 1
            elif records is not None:
                records.add(key(index), result)
            found[index] = result
            tick()
        if render_mode == "human":
            env.get_wrapper_attr("wait_for_window")()
    finally:
        env.close()
    scores = tuple(score for _, score in sorted(found.items()))
    return Evaluation(name, scenes, seed, feasibility, policy_grasps(playing), scores, crashes, made_with)


def minimum_clearances(
    scenes: SceneSet,
    grasps: str,
    *,
    workers: int = 1,
    ray: str = "",
    records: ResultRecords | None = None,
    tick: Callable[[], object] = lambda: None,
) -> list[Floor]:
    """The minimum number of clearances of every scene: that of the suite, or found by the planner.

    Raises:
        SuiteError: the suite has none for these grasps.
        LearningError: a worker was killed, or the planner failed.
    """
    every = range(len(scenes.scenes))
    if scenes.suite:
        return [find_floor(scenes.scenes[index], grasps) for index in every]
    job = _Job(f"minimum for {grasps}", scenes, 0, "")
    env = scenes.scenes[0].make()
    key = partial(_key, job, provenance(env))
    env.close()
    known = {index: records.get(key(index)) for index in every} if records is not None else {}
    found = {index: floor for index, floor in known.items() if isinstance(floor, Floor)}
    missing = [index for index in every if index not in found]
    for index, result in run_jobs(partial(_find_floor, scenes, grasps), missing, workers, ray=ray):
        if isinstance(result, Crash | Killed):
            raise LearningError(f"minimum number of clearances of scene {index} of {scenes.name}: {_text(result)}")
        if records is not None:
            records.add(key(index), result)
        found[index] = result
        tick()
    return [found[index] for index in every]


def _make_env(job: _Job, policy: AnyPolicy, render_mode: str | None = None) -> gym.Env[Any, Any]:
    rendering = {} if render_mode is None else {"render_mode": render_mode}
    return _scene(job, 0, policy).make(**env_keywords(policy), **rendering)


def _scene(job: _Job, index: int, policy: AnyPolicy) -> Scene:
    scene = job.scenes.scenes[index]
    return skill_scene(scene, job.feasibility) if acts_by_skills(policy) else scene


def _play_here(
    job: _Job, index: int, env: gym.Env, policy: AnyPolicy, watch: Watch | None, count_crashes: bool
) -> Score | Crash:
    try:
        return play_scene(_scene(job, index, policy), env, policy, watch=watch)
    except (SuiteError, PolicyError):
        raise
    except Exception as problem:
        if not count_crashes:
            raise  # with the traceback of the policy's own code
        return Crash(f"{type(problem).__name__}: {problem}", is_final=True)


@lru_cache(maxsize=2)
def _env_and_policy(job: _Job) -> tuple[gym.Env[Any, Any], AnyPolicy]:
    """Made once in a worker for all scenes of a set, which have the same environment."""
    policy = load_policy(job.policy, job.seed)
    return _make_env(job, policy), policy


def _play_in_worker(job: _Job, index: int) -> Score | ClutterEnvError:
    env, policy = _env_and_policy(job)
    try:
        return play_scene(_scene(job, index, policy), env, policy)
    except (SuiteError, PolicyError) as problem:
        return problem


def _find_floor(scenes: SceneSet, grasps: str, index: int) -> Floor:
    return find_floor(scenes.scenes[index], grasps)


def _crashed(job: _Job, index: int, crash: Crash | Killed, count_crashes: bool) -> Score:
    """The score of an episode in which the policy raised an exception; other crashes are errors."""
    seed = job.scenes.scenes[index].seed
    where = f"{job.policy} on scene {index} of {job.scenes.name} (seed {seed})"
    if isinstance(crash, Killed) or not crash.is_final:
        raise LearningError(f"{where}: {_text(crash)}")
    if not count_crashes:
        raise PolicyCrashed(f"{where}; count_crashes counts such episodes as failures\n\n{crash.detail}")
    return Score.of_crash(seed, crash.summary)


def _text(problem: Crash | Killed) -> str:
    return problem.detail if isinstance(problem, Crash) else f"killed after {problem.seconds:.0f} s"


def _key(job: _Job, made_with: Mapping[str, Any], index: int) -> str:
    return ResultRecords.key(job.scenes, index, job.policy, job.seed, job.feasibility, made_with)
