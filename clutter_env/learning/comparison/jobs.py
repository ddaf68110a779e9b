"""One policy on one scene: the unit of work of an evaluation or a comparison."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeAlias

import gymnasium as gym

from clutter_env.errors import SuiteError
from clutter_env.learning.comparison.evaluation import Score, SuitePolicy, play_scene
from clutter_env.learning.comparison.scene_sets import Scene, SceneSet, find_floor, skill_scene
from clutter_env.learning.comparison.suite_policies import acts_by_skills, env_keywords, load_policy
from clutter_env.parallel import Crash, Killed
from clutter_env.suites import Floor

__all__ = ["FLOOR", "EvaluationJob", "Result", "WrongScene", "failed_episode", "run_job"]

FLOOR = "floor of "
"""In place of a policy, followed by a grasp set: the minimum number of clearances of the scene."""


@dataclass(frozen=True)
class EvaluationJob:
    """One policy on one scene.

    Attributes:
        scenes: the set of the scene.
        index: of the scene in it.
        policy: a name for `load_policy`, or `FLOOR` and a grasp set.
        seed: of the built-in random policies.
        feasibility: of the Skill environment, for policies that act by skills.
    """

    scenes: SceneSet
    index: int
    policy: str
    seed: int = 0
    feasibility: str = "oracle"


@dataclass(frozen=True)
class WrongScene:
    """The scene is not the one that the suite was made with; the message says what differs."""

    message: str


Result: TypeAlias = Score | Floor


def run_job(job: EvaluationJob) -> Result | WrongScene:
    """Play the job's episode, or find the floor of its scene; in a worker."""
    scene = job.scenes.scenes[job.index]
    if job.policy.startswith(FLOOR):
        return find_floor(scene, job.policy.removeprefix(FLOOR))
    env, policy = _env_and_policy(job.scenes, job.policy, job.seed, job.feasibility)
    try:
        return play_scene(_as_played(scene, policy, job.feasibility), env, policy)
    except SuiteError as problem:
        return WrongScene(str(problem))


def failed_episode(job: EvaluationJob, crash: Crash | Killed) -> Score | None:
    """The score of a policy that raised an exception; None if the worker itself was killed or could not work."""
    if isinstance(crash, Killed) or not crash.is_final:
        return None
    return Score.of_crash(job.scenes.scenes[job.index].seed, crash.summary)


@lru_cache(maxsize=2)
def _env_and_policy(scenes: SceneSet, name: str, seed: int, feasibility: str) -> tuple[gym.Env[Any, Any], SuitePolicy]:
    """Made once in a worker for all scenes of a set, which have the same environment."""
    policy = load_policy(name, seed)
    return _as_played(scenes.scenes[0], policy, feasibility).make(**env_keywords(policy)), policy


def _as_played(scene: Scene, policy: SuitePolicy, feasibility: str) -> Scene:
    return skill_scene(scene, feasibility) if acts_by_skills(policy) else scene
