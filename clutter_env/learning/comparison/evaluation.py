"""Held-out episodes of a policy or an expert, and their scores."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.learning.demonstrations.experts import Expert
from clutter_env.learning.task import HELD_OUT

__all__ = ["MOVED", "Score", "held_out_seeds", "play", "play_expert", "success_rate"]

MOVED = 0.05
"""[m] An object that ends farther than this from its initial position has been moved."""


@dataclass(frozen=True)
class Score:
    """The score of one episode.

    Attributes:
        seed: of the scene.
        is_success: whether the last step's info says success; of the Retrieve and Skill environments clean success.
        moved: number of objects other than the target that were moved; see `MOVED`.
        fallen: number of objects that have toppled or left the table.
        steps: of the environment.
        sim_s: simulated time [s].
        wall_s: wall time [s], with planning and the policy's inference.
        failure: cause of the failure, "" for success.
        lifted: whether the last step's info says that the target is lifted, whatever else has moved.
        disturbed: number of objects that have been disturbed.
    """

    seed: int
    is_success: bool
    moved: int
    fallen: int
    steps: int
    sim_s: float
    wall_s: float
    failure: str
    lifted: bool = False
    disturbed: int = 0


def held_out_seeds(count: int, first: int = HELD_OUT) -> range:
    """Seeds on which nothing is trained."""
    return range(first, first + count)


def play(env: gym.Env, act: Callable[[Any], Any], seed: int, max_steps: int | None = None) -> Score:
    """One episode of a policy, cut off after `max_steps`, or when the target is lifted, which decides a retrieval."""
    start = _start(env, seed)
    observation, steps, is_over, failure = start.observation, 0, False, ""
    while not is_over:
        observation, _, terminated, truncated, info = env.step(act(observation))
        steps += 1
        is_over = terminated or truncated or steps == max_steps or _is_retrieved(env, info)
        failure = "budget spent" if terminated else "time limit"
    return _score(env, seed, info, start, steps, failure)


def play_expert(env: gym.Env, expert: Expert, seed: int) -> Score:
    """One episode of an expert."""
    start = _start(env, seed)
    info = start.info
    expert.reset()
    steps, is_over = 0, False
    while not (is_over or expert.done):
        _, _, terminated, truncated, info = env.step(expert.act())
        steps += 1
        is_over = terminated or truncated or _is_retrieved(env, info)
    failure = str(expert.report_values.get("failure") or "not held to the end")
    return _score(env, seed, info, start, steps, failure)


def success_rate(env: gym.Env, act: Callable[[Any], Any], seeds: Sequence[int], max_steps: int | None = None) -> float:
    """Share of the episodes that succeed, within `max_steps` each."""
    return float(np.mean([play(env, act, seed, max_steps).is_success for seed in seeds]))


class _Start(NamedTuple):
    """The beginning of an episode: wall time [s], what `reset` returned, centres (n, 3) [m] of the objects."""

    wall_s: float
    observation: Any
    info: dict[str, Any]
    positions: NDArray[np.float64]


def _start(env: gym.Env, seed: int) -> _Start:
    started = time.perf_counter()
    observation, info = env.reset(seed=seed)
    return _Start(started, observation, info, _positions(env))


def _is_retrieved(env: gym.Env, info: dict[str, Any]) -> bool:
    """Whether a retrieval is decided: the target is lifted, which is a success or can never become one."""
    return bool(info["lifted"]) and isinstance(_physics_env(env), RetrieveEnv)


def _score(env: gym.Env, seed: int, info: dict[str, Any], start: _Start, steps: int, failure: str) -> Score:
    """The score of an episode that has ended; `info` is of its last step."""
    away = np.linalg.norm(_positions(env) - start.positions, axis=1) > MOVED
    physics_env = _physics_env(env)
    away[physics_env.target_slot : physics_env.target_slot + 1] = False
    is_success = bool(info["is_success"])
    if physics_env.target_slot >= 0 and physics_env.measurements.is_off[physics_env.target_slot]:
        failure = "target lost"
    elif info["lifted"]:
        failure = "not clean"
    return Score(
        seed=seed,
        is_success=is_success,
        moved=int(away.sum()),
        fallen=int(info["num_fallen"]),
        disturbed=int(info["num_disturbed"]),
        lifted=bool(info["lifted"]),
        steps=steps,
        sim_s=float(physics_env.data.time),
        wall_s=time.perf_counter() - start.wall_s,
        failure="" if is_success else failure,
    )


def _physics_env(env: gym.Env) -> Any:
    """The environment that simulates the physics: of `Skill` the one that it contains."""
    return getattr(env.unwrapped, "physics_env", env.unwrapped)


def _positions(env: gym.Env) -> NDArray[np.float64]:
    """Centres (n, 3) [m] of the objects in the simulation."""
    return np.array(_physics_env(env).measurements.poses[:, :3])
