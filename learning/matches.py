"""Who plays which scene: the unit of work of a comparison, the same in every process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym

from learning.baselines import BASELINES, greedy_agent, random_agent
from learning.errors import LearningError
from learning.evaluation import Score, play, play_expert
from learning.experts import expert_names, make_expert
from learning.runs import RUN_FILE, load_run
from learning.task import Task

__all__ = ["Match", "arena_name", "contender_name", "floor_of", "play_match", "run_environment"]


@dataclass(frozen=True)
class Match:
    """One contender on one scene.

    Attributes:
        env_id: of the comparison, such as clutter_env/Retrieve-o15-v0; skills play the scene of the same seed.
        contender: a strategy of the planner or a script, one of `BASELINES`, "floor", or the directory of a run.
        seed: of the scene.
        max_steps: after which an episode of low-level actions is cut off.
    """

    env_id: str
    contender: str
    seed: int
    max_steps: int | None = None


def play_match(matches: Sequence[Match], index: int) -> Score | int | None:
    """Play one of the matches; runs in a worker. For "floor": the fewest objects that must be moved, if it is known."""
    match = matches[index]
    if match.contender == "floor":
        return floor_of(match.env_id, match.seed)
    if match.contender in expert_names(match.env_id):
        env = Task(match.env_id).make()
        try:
            return play_expert(env, make_expert(env, match.contender), match.seed)
        finally:
            env.close()
    if match.contender in BASELINES:
        env = _skills_or(match.env_id)
        act = greedy_agent(env) if match.contender == "greedy" else random_agent(env, match.seed)
        return play(env, act, match.seed, match.max_steps)
    return _play_run(match)


def floor_of(env_id: str, seed: int) -> int | None:
    """The proved minimum number of objects to clear in that scene, None without a proof."""
    from planners.scene import Scene
    from planners.solve import clearance_floor

    env = Task(env_id).make()
    try:
        _, info = env.reset(seed=seed)
        arena: Any = env.unwrapped
        floor = clearance_floor(Scene.from_mujoco(arena.model, arena.data, arena.robot), info["target"])
        return floor.count if floor.proved else None
    finally:
        env.close()


def contender_name(contender: str) -> str:
    """What to call it in a table; runs that differ in their seed alone share a name."""
    path = Path(contender)
    if not (path / RUN_FILE).exists():
        return contender
    level = "skills" if "/Skill" in run_environment(path) else "actions"
    return f"{load_run(path)['algorithm']} ({level})"


def run_environment(directory: Path) -> str:
    """Id of the environment that a training run was made on.

    Raises:
        LearningError: the directory holds no training run.
    """
    return str(load_run(directory)["task"]["env_id"])


def arena_name(env_id: str) -> str:
    """ "o15", "reach" or "pick": what environments of one scene have in common."""
    name = env_id.rpartition("/")[2].removesuffix("-v0")
    return name.partition("-")[2] or name.lower()


def _play_run(match: Match) -> Score:
    from learning.agents import load_agent  # brings in torch, which the other contenders do without

    directory = Path(match.contender)
    env_id = run_environment(directory)
    if arena_name(env_id) != arena_name(match.env_id):
        raise LearningError(f"{directory} was trained on {env_id}, which has other scenes than {match.env_id}")
    env = _env_of(env_id)
    return play(env, load_agent(directory, env), match.seed, None if "/Skill" in env_id else match.max_steps)


def _skills_or(env_id: str) -> gym.Env:
    """The skills of a Retrieve environment, or the environment itself."""
    return _env_of(env_id.replace("/Retrieve", "/Skill"))


def _env_of(env_id: str) -> gym.Env:
    return Task(env_id).make()
