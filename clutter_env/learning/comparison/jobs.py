"""One policy on one scene: the unit of work of a comparison."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clutter_env.learning.comparison.evaluation import Score, play, play_expert
from clutter_env.learning.demonstrations.experts import MAX_SCRIPT_STEPS, expert_keywords, expert_names, make_expert
from clutter_env.learning.errors import LearningError
from clutter_env.learning.policies.baselines import BASELINES, Bulldozer, greedy_agent, random_agent
from clutter_env.learning.policies.runs import RUN_FILE, load_run
from clutter_env.learning.task import Task

__all__ = ["FLOOR", "EvaluationJob", "floor_of", "policy_name", "run_environment", "run_job", "scene_set_name"]

FLOOR = "floor"
"""In place of a policy: the minimum number of clearances of the scene."""


@dataclass(frozen=True)
class EvaluationJob:
    """One policy on one scene.

    Attributes:
        env_id: of the comparison, such as clutter_env/Retrieve-o15-v0; policies that act by skills play the Skill
            environment with as many objects, where the same seed gives the same scene.
        policy: one of `expert_names` or `BASELINES`, `FLOOR`, or the directory of a training run.
        seed: of the scene.
        max_steps: after which an episode of low-level actions is cut off.
    """

    env_id: str
    policy: str
    seed: int
    max_steps: int | None = None


def run_job(job: EvaluationJob) -> Score | int | None:
    """Play the job's episode, in a worker. For `FLOOR`: the minimum number of clearances, None if it is not proved."""
    if job.policy == FLOOR:
        return floor_of(job.env_id, job.seed)
    if job.policy in expert_names(job.env_id):
        env = Task(job.env_id, expert_keywords(job.policy)).make()
        try:
            return play_expert(env, make_expert(env, job.policy), job.seed)
        finally:
            env.close()
    if job.policy == "bulldozer":
        env, bulldozer = Task(job.env_id, Bulldozer.env_keywords).make(), Bulldozer()
        bulldozer.reset(env, {})
        return play(env, bulldozer.act, job.seed, min(job.max_steps or MAX_SCRIPT_STEPS, MAX_SCRIPT_STEPS))
    if job.policy in BASELINES:
        env = Task(job.env_id.replace("/Retrieve", "/Skill")).make()
        act = greedy_agent(env) if job.policy == "greedy" else random_agent(env, job.seed)
        return play(env, act, job.seed, job.max_steps)
    return _play_run(job)


def floor_of(env_id: str, seed: int) -> int | None:
    """The minimum number of clearances of a scene with side grasps, None if it is not proved."""
    # The other policies do without the planner and its compiled kernels.
    from planners.planner import clearance_floor
    from planners.scene import Scene

    env = Task(env_id).make()
    try:
        _, info = env.reset(seed=seed)
        physics_env: Any = env.unwrapped
        scene = Scene.from_mujoco(physics_env.model, physics_env.data, physics_env.robot)
        floor = clearance_floor(scene, info["target"], grasps="side")
        return floor.count if floor.proved else None
    finally:
        env.close()


def policy_name(policy: str) -> str:
    """The name of a policy in a table; runs that differ in their seed alone have the same name."""
    path = Path(policy)
    if not (path / RUN_FILE).exists():
        return policy
    level = "skills" if "/Skill" in run_environment(path) else "actions"
    return f"{load_run(path)['algorithm']} ({level})"


def run_environment(directory: Path) -> str:
    """Id of the environment that a run was trained on.

    Raises:
        LearningError: the directory holds no training run.
    """
    return str(load_run(directory)["task"]["env_id"])


def scene_set_name(env_id: str) -> str:
    """ "o15", "reach" or "pick": environments with the same name have the same scenes."""
    name = env_id.rpartition("/")[2].removesuffix("-v0")
    return name.partition("-")[2] or name.lower()


def _play_run(job: EvaluationJob) -> Score:
    from clutter_env.learning.policies.agents import load_agent  # needs torch, which the other policies do without

    directory = Path(job.policy)
    env_id = run_environment(directory)
    if scene_set_name(env_id) != scene_set_name(job.env_id):
        raise LearningError(f"{directory} was trained on {env_id}, which has other scenes than {job.env_id}")
    env = Task(env_id).make()
    return play(env, load_agent(directory, env), job.seed, None if "/Skill" in env_id else job.max_steps)
