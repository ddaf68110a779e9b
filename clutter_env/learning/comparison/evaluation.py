"""An episode of a policy, and its score: the same for the commands `evaluate` and `compare`, and during training."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.learning.task import HELD_OUT

__all__ = [
    "MOVED",
    "DrawnScene",
    "PlayedScene",
    "Score",
    "SuitePolicy",
    "begin_episode",
    "held_out_seeds",
    "play",
    "play_scene",
    "success_rate",
]

MOVED = 0.05
"""[m] An object that ends farther than this from its initial position has been moved."""


@dataclass(frozen=True)
class Score:
    """The score of one episode.

    Attributes:
        seed: of the scene.
        clean: success: in Retrieve and Skill, the target was lifted, and nothing had fallen or been disturbed by then;
            in Reach and Pick, the goal was reached in the end.
        lifted: the target was lifted.
        steps: of the environment: control steps, or skills.
        sim_s: simulated time [s].
        moved: number of objects other than the target that ended elsewhere; see `MOVED`.
        cleared, disturbed, fallen: numbers of objects, see `clutter_env.envs.success`.
        refused: number of skills that the motion layer refused; 0 for policies that do not act by skills.
        failure: "" for success, else why not.
        wall_s: wall time [s], with planning and the policy's inference.
    """

    seed: int
    clean: bool
    lifted: bool
    steps: int
    sim_s: float
    moved: int
    cleared: int
    disturbed: int
    fallen: int
    refused: int
    failure: str
    wall_s: float

    @classmethod
    def of_crash(cls, seed: int, cause: str) -> Score:
        """The score of a policy that raised an exception: a failed episode."""
        return cls(seed, False, False, 0, 0.0, 0, 0, 0, 0, 0, cause, 0.0)


class SuitePolicy(Protocol):
    """What plays scenes. What it does in an episode must not depend on earlier episodes.

    Optional attributes: `env_keywords`, a dictionary of keyword arguments of the environment among control_mode,
    obs_mode, image_size and reward_mode; `grasps`, "side" or "all" (the default): the grasps that it uses, by whose
    floors its results are broken down; `acts_by_skills`, true for one that plays the Skill environment of the scenes;
    `done`, true once the policy gives up; `failure`, then the reason.
    """

    def reset(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> None:
        """Start an episode; `env` has been reset and returned `info`."""
        ...

    def act(self, observation: Any) -> Any:
        """The next action."""
        ...


class PlayedScene(Protocol):
    """A scene of a suite, or one reset of an environment."""

    @property
    def seed(self) -> int:
        """Of the reset."""
        ...

    def reset(self, env: gym.Env[Any, Any]) -> tuple[Any, dict[str, Any]]:
        """Start the episode; observation and info."""
        ...


def play_scene(scene: PlayedScene, env: gym.Env[Any, Any], policy: SuitePolicy, max_steps: int | None = None) -> Score:
    """One episode: until the target has been lifted, cleanly or not, or is lost; the policy gives up; or time is up.

    In Reach and Pick an episode ends with its time alone.

    Args:
        scene: how the episode begins.
        env: an environment of that scene.
        policy: that plays it.
        max_steps: after which the episode is cut off, if the environment does not end it before.

    Raises:
        SuiteError: the first state is not the one that the suite was made with.
    """
    started = time.perf_counter()
    observation, info = scene.reset(env)
    positions = _positions(env)
    policy.reset(env, info)
    steps, is_over, failure = 0, False, ""
    while not is_over:
        if getattr(policy, "done", False):
            failure = str(getattr(policy, "failure", "")) or "gave up"
            break
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        steps += 1
        is_over = terminated or truncated or steps == max_steps or _is_retrieved(env, info)
        failure = _ending(env, terminated)
    away = np.linalg.norm(_positions(env) - positions, axis=1) > MOVED
    target = _physics_env(env).target_slot
    away[target : target + 1] = False
    clean = _is_clean(env, info)
    return Score(
        seed=scene.seed,
        clean=clean,
        lifted=bool(info["lifted"]),
        steps=steps,
        sim_s=float(_physics_env(env).data.time),
        moved=int(away.sum()),
        cleared=int(info["num_cleared"]),
        disturbed=int(info["num_disturbed"]),
        fallen=int(info["num_fallen"]),
        refused=int(info.get("num_refused", 0)),
        failure="" if clean else "not clean" if info["lifted"] else failure,
        wall_s=time.perf_counter() - started,
    )


def play(env: gym.Env, act: Callable[[Any], Any], seed: int, max_steps: int | None = None) -> Score:
    """One episode of a function from observations to actions, on the scene of a seed; see `play_scene`."""
    return play_scene(DrawnScene(seed), env, _Function(act), max_steps)


def begin_episode(act: Callable[[Any], Any]) -> None:
    """Let a function from observations to actions forget the last episode, if it has a method `reset` for that."""
    reset = getattr(act, "reset", None)
    if reset is not None:
        reset()


def held_out_seeds(count: int, first: int = HELD_OUT) -> range:
    """Seeds on which nothing is trained."""
    return range(first, first + count)


def success_rate(env: gym.Env, act: Callable[[Any], Any], seeds: Sequence[int], max_steps: int | None = None) -> float:
    """Share of the episodes that succeed, within `max_steps` each."""
    return float(np.mean([play(env, act, seed, max_steps).clean for seed in seeds]))


@dataclass(frozen=True)
class DrawnScene:
    """The scene that an environment draws for a seed."""

    seed: int

    def reset(self, env: gym.Env[Any, Any]) -> tuple[Any, dict[str, Any]]:
        """Start the episode; observation and info."""
        return env.reset(seed=self.seed)


@dataclass(frozen=True)
class _Function:
    """A function as a policy; it has a method `reset` if it remembers something."""

    act: Callable[[Any], Any]

    def reset(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        begin_episode(self.act)


def _is_retrieved(env: gym.Env, info: Mapping[str, Any]) -> bool:
    """Whether a retrieval is decided: the target is lifted, which is a success or can never become one."""
    return bool(info["lifted"]) and isinstance(_physics_env(env), RetrieveEnv)


def _is_clean(env: gym.Env, info: Mapping[str, Any]) -> bool:
    if not isinstance(_physics_env(env), RetrieveEnv):
        return bool(info["is_success"])
    return bool(info["lifted"]) and not info["num_fallen"] and not info["num_disturbed"]


def _ending(env: gym.Env, terminated: bool) -> str:
    """Why an episode is over whose target was not lifted."""
    physics_env = _physics_env(env)
    if physics_env.target_slot >= 0 and physics_env.measurements.is_off[physics_env.target_slot]:
        return "target lost"
    if not terminated:
        return "time limit"
    return "object fallen" if physics_env is env.unwrapped else "budget spent"


def _physics_env(env: gym.Env) -> Any:
    """The environment that simulates the physics: of `Skill` the one that it contains."""
    return getattr(env.unwrapped, "physics_env", env.unwrapped)


def _positions(env: gym.Env) -> NDArray[np.float64]:
    """Centres (n, 3) [m] of the objects in the simulation."""
    return np.array(_physics_env(env).measurements.poses[:, :3])
