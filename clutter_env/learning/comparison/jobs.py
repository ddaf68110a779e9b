"""Who plays which scene: the unit of work of a comparison, the same in every process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym

from clutter_env.learning.comparison.evaluation import Score, play, play_expert
from clutter_env.learning.demonstrations.experts import expert_names, make_expert
from clutter_env.learning.errors import LearningError
from clutter_env.learning.policies.baselines import BASELINES, greedy_agent, random_agent
from clutter_env.learning.policies.runs import RUN_FILE, load_run
from clutter_env.learning.task import Task

__all__ = ["EvaluationJob", "floor_of", "policy_name", "run_environment", "run_job", "scene_set_name"]


@dataclass(frozen=True)
class EvaluationJob:
    """One policy on one scene.

    Attributes:
        env_id: of the comparison, such as clutter_env/Retrieve-o15-v0; skills play the scene of the same seed.
        policy: a strategy of the planner or a script, one of `BASELINES`, "floor", or the directory of a run.
        seed: of the scene.
        max_steps: after which an episode of low-level actions is cut off.
    """

    env_id: str
    policy: str
    seed: int
    max_steps: int | None = None


def run_job(jobs: Sequence[EvaluationJob], index: int) -> Score | int | None:
    """Play one of the jobs; runs in a worker. For "floor": the fewest objects that must be moved, if it is known."""
    match = jobs[index]
    if match.policy == "floor":
        return floor_of(match.env_id, match.seed)
    if match.policy in expert_names(match.env_id):
        env = Task(match.env_id).make()
        try:
            return play_expert(env, make_expert(env, match.policy), match.seed)
        finally:
            env.close()
    if match.policy in BASELINES:
        env = _skills_or(match.env_id)
        act = greedy_agent(env) if match.policy == "greedy" else random_agent(env, match.seed)
        return play(env, act, match.seed, match.max_steps)
    return _play_run(match)


def floor_of(env_id: str, seed: int) -> int | None:
    """The proved minimum number of objects to clear in that scene, None without a proof."""
    from planners.planner import clearance_floor
    from planners.scene import Scene

    env = Task(env_id).make()
    try:
        _, info = env.reset(seed=seed)
        scene_set: Any = env.unwrapped
        floor = clearance_floor(Scene.from_mujoco(scene_set.model, scene_set.data, scene_set.robot), info["target"])
        return floor.count if floor.proved else None
    finally:
        env.close()


def policy_name(policy: str) -> str:
    """What to call it in a table; runs that differ in their seed alone share a name."""
    path = Path(policy)
    if not (path / RUN_FILE).exists():
        return policy
    level = "skills" if "/Skill" in run_environment(path) else "actions"
    return f"{load_run(path)['algorithm']} ({level})"


def run_environment(directory: Path) -> str:
    """Id of the environment that a training run was made on.

    Raises:
        LearningError: the directory holds no training run.
    """
    return str(load_run(directory)["task"]["env_id"])


def scene_set_name(env_id: str) -> str:
    """ "o15", "reach" or "pick": what environments of one scene have in common."""
    name = env_id.rpartition("/")[2].removesuffix("-v0")
    return name.partition("-")[2] or name.lower()


def _play_run(match: EvaluationJob) -> Score:
    from clutter_env.learning.policies.agents import (
        load_agent,  # brings in torch, which the other policies do without
    )

    directory = Path(match.policy)
    env_id = run_environment(directory)
    if scene_set_name(env_id) != scene_set_name(match.env_id):
        raise LearningError(f"{directory} was trained on {env_id}, which has other scenes than {match.env_id}")
    env = _env_of(env_id)
    return play(env, load_agent(directory, env), match.seed, None if "/Skill" in env_id else match.max_steps)


def _skills_or(env_id: str) -> gym.Env:
    """The skills of a Retrieve environment, or the environment itself."""
    return _env_of(env_id.replace("/Retrieve", "/Skill"))


def _env_of(env_id: str) -> gym.Env:
    return Task(env_id).make()
