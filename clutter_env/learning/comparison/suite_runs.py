"""A policy on the scenes of a suite: episodes played in parallel, and the content of the results file."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from clutter_env.errors import SuiteError
from clutter_env.learning.comparison.suite_policies import SuitePolicy, env_keywords, load_policy, policy_grasps
from clutter_env.learning.errors import LearningError
from clutter_env.learning.task import versions
from clutter_env.parallel.jobs import Crash, Killed, run_jobs
from clutter_env.reporting.statistics import wilson
from clutter_env.suites import SuiteScene, content_digest, suite

__all__ = ["STRATA", "Evaluation", "SuiteEpisode", "evaluate", "play_scene", "results"]

FORMAT = 1
STRATA = ("0", "1", "2", "3 or more", "none")
"""Minimum numbers of clearances, for the policy's grasps, by which the success rates are broken down; "none":
there is no plan."""


@dataclass(frozen=True)
class Evaluation:
    """Which policy plays which scenes.

    Attributes:
        suite: name of the suite.
        policy: name of the policy, see `load_policy`.
        split: "test" or "validation".
        scenes: only the first so many scenes of the split; None for all.
        seed: of the built-in random policy.
    """

    suite: str
    policy: str
    split: str = "test"
    scenes: int | None = None
    seed: int = 0


@dataclass(frozen=True)
class SuiteEpisode:
    """One episode.

    Attributes:
        index, seed: of the scene.
        floor: the minimum number of clearances for the policy's grasps, None if there is no plan.
        clean: the target was lifted, and nothing had fallen or been disturbed by then.
        lifted: the target was lifted.
        steps: control steps.
        sim_s: simulated time [s].
        disturbed, fallen, cleared: numbers of objects, see `clutter_env.envs.judge`.
        failure: "" for a clean success, else why not.
    """

    index: int
    seed: int
    floor: int | None
    clean: bool
    lifted: bool
    steps: int
    sim_s: float
    disturbed: int
    fallen: int
    cleared: int
    failure: str


class _Job(NamedTuple):
    """One scene of an evaluation."""

    evaluation: Evaluation
    scene: int


class _Played(NamedTuple):
    """What a worker returns: the episode, or the scene that is not the suite's; and the wall time [s]."""

    episode: SuiteEpisode | None
    mismatch: str
    wall_s: float


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
    scenes = _scenes(evaluation)
    policy = load_policy(evaluation.policy, evaluation.seed)
    env_keywords(policy)
    grasps = policy_grasps(policy)
    played: dict[int, _Played] = {}
    for job, result in run_jobs(_play, (_Job(evaluation, scene.index) for scene in scenes), workers, ray=ray):
        if isinstance(result, Killed) or (isinstance(result, Crash) and not result.is_final):
            raise LearningError(f"scene {job.scene} of suite {evaluation.suite!r}: {result}")
        if isinstance(result, Crash):
            result = _Played(_crashed(scenes[job.scene], grasps, result.summary), "", 0.0)
        if result.episode is None:
            raise SuiteError(result.mismatch)
        played[job.scene] = result
        tick()
    episodes = [entry.episode for _, entry in sorted(played.items()) if entry.episode is not None]
    return results(evaluation, episodes) | {"wall_s": [entry.wall_s for _, entry in sorted(played.items())]}


def results(evaluation: Evaluation, episodes: Sequence[SuiteEpisode]) -> dict[str, Any]:
    """Everything but wall times, JSON values. `digest` covers the suite, the policy's name and the episodes: equal
    digests mean equal results."""
    played = {
        "suite": evaluation.suite,
        "suite_sha256": suite(evaluation.suite).digest,
        "split": evaluation.split,
        "policy": evaluation.policy,
        "seed": evaluation.seed,
        "grasps": policy_grasps(load_policy(evaluation.policy, evaluation.seed)),
        "episodes": [asdict(episode) for episode in episodes],
    }
    return {
        "format": FORMAT,
        "versions": versions(),
        "digest": content_digest(played),
        "summary": _summary(episodes),
        **played,
    }


def play_scene(scene: SuiteScene, env: gym.Env[Any, Any], policy: SuitePolicy) -> SuiteEpisode:
    """One episode: until the target has been lifted, cleanly or not, or is lost; the policy gives up; or time is up.

    Raises:
        SuiteError: the first state is not the one that the suite was made with.
    """
    observation, info = scene.reset(env)
    policy.reset(env, info)
    steps, is_over, failure = 0, False, ""
    while not is_over:
        if getattr(policy, "done", False):
            failure = str(getattr(policy, "failure", "")) or "gave up"
            break
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        steps += 1
        is_over = terminated or truncated or info["lifted"]
        failure = "target lost" if terminated else "time limit"
    clean = bool(info["lifted"]) and not info["num_fallen"] and not info["num_disturbed"]
    physics: Any = env.unwrapped
    return SuiteEpisode(
        index=scene.index,
        seed=scene.seed,
        floor=scene.floor(policy_grasps(policy)).count,
        clean=clean,
        lifted=bool(info["lifted"]),
        steps=steps,
        sim_s=float(physics.data.time),
        disturbed=int(info["num_disturbed"]),
        fallen=int(info["num_fallen"]),
        cleared=int(info["num_cleared"]),
        failure="" if clean else "not clean" if info["lifted"] else failure,
    )


def _scenes(evaluation: Evaluation) -> tuple[SuiteScene, ...]:
    scenes = suite(evaluation.suite).split(evaluation.split)
    if evaluation.scenes is not None and not 1 <= evaluation.scenes <= len(scenes):
        raise LearningError(f"scenes={evaluation.scenes} is not valid; it must be from 1 to {len(scenes)}")
    return scenes[: evaluation.scenes]


def _play(job: _Job) -> _Played:
    """Play the job's scene, in a worker."""
    started = time.perf_counter()
    evaluation = job.evaluation
    scene = suite(evaluation.suite).split(evaluation.split)[job.scene]
    env, policy = _env_and_policy(evaluation)
    try:
        episode = play_scene(scene, env, policy)
    except SuiteError as problem:
        return _Played(None, str(problem), 0.0)
    return _Played(episode, "", time.perf_counter() - started)


@cache
def _env_and_policy(evaluation: Evaluation) -> tuple[gym.Env[Any, Any], SuitePolicy]:
    """Made once in a worker; all scenes of a suite have the same environment."""
    policy = load_policy(evaluation.policy, evaluation.seed)
    return suite(evaluation.suite).test[0].make(**env_keywords(policy)), policy


def _crashed(scene: SuiteScene, grasps: str, cause: str) -> SuiteEpisode:
    """The episode of a policy that raised an exception."""
    return SuiteEpisode(scene.index, scene.seed, scene.floor(grasps).count, False, False, 0, 0.0, 0, 0, 0, cause)


def _summary(episodes: Sequence[SuiteEpisode]) -> dict[str, Any]:
    """Success rates with Wilson's 95% intervals, over all episodes and by stratum; means over all episodes."""
    strata = {name: [one for one in episodes if _stratum(one.floor) == name] for name in STRATA}
    names = ("steps", "sim_s", "disturbed", "fallen", "cleared")
    return {
        **_rates(episodes),
        "by_floor": {name: _rates(group) for name, group in strata.items() if group},
        "mean": {name: float(np.mean([getattr(one, name) for one in episodes])) for name in names},
    }


def _stratum(floor: int | None) -> str:
    return STRATA[-1] if floor is None else STRATA[min(floor, 3)]


def _rates(episodes: Sequence[SuiteEpisode]) -> dict[str, Any]:
    clean, lifted = (sum(getattr(one, name) for one in episodes) for name in ("clean", "lifted"))
    count = len(episodes)
    return {
        "episodes": count,
        "clean": {"successes": clean, **wilson(clean, count)._asdict()},
        "lifted": {"successes": lifted, **wilson(lifted, count)._asdict()},
    }
