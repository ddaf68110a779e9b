"""One episode of a policy, and its score: the same for all commands, and during training."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.policies.protocol import AnyPolicy, begin_episode
from clutter_env.task import HELD_OUT

MOVED = 0.05
"""[m] An object that ends farther than this from its initial position has been moved."""

Watch = Callable[[gym.Env[Any, Any], AnyPolicy], None]
"""Called with the environment and the policy after the reset and after every step of an episode."""


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
        cleared, disturbed, fallen: numbers of objects, see `clutter_env.envs`.
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
        return cls(seed, False, False, 0, 0.0, 0, 0, 0, 0, 0, f"crashed: {cause}", 0.0)


def play_scene(
    scene: Any, env: gym.Env, policy: AnyPolicy, max_steps: int | None = None, watch: Watch | None = None
) -> Score:
    """One episode: until the target has been lifted, cleanly or not, or is lost; the policy gives up; or time is up.

    In Reach and Pick an episode ends with its time alone.

    Args:
        scene: one with a `seed` and a `reset(env)`, see `clutter_env.evaluation.scenes`; or the seed with which the
            environment draws it.
        env: an environment of that scene.
        policy: that plays it.
        max_steps: after which the episode is cut off, if the environment does not end it before.
        watch: called after the reset and after every step.

    Raises:
        SuiteError: the first state is not the one that the suite was made with.
        PolicyError: the policy is not made for this environment.
    """
    started = time.perf_counter()
    observation, info = env.reset(seed=scene) if isinstance(scene, int) else scene.reset(env)
    physics_env: Any = getattr(env.unwrapped, "physics_env", env.unwrapped)  # Skill contains one
    is_retrieval = isinstance(physics_env, RetrieveEnv)
    positions = _positions(physics_env)
    begin_episode(policy, info, env)
    steps, is_over, failure = 0, False, ""
    while not is_over:
        if watch is not None:
            watch(env, policy)
        if getattr(policy, "done", False):
            failure = str(getattr(policy, "failure", "")) or "gave up"
            break
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        steps += 1
        # A lifted target is a success or can never become one.
        is_over = terminated or truncated or steps == max_steps or (is_retrieval and bool(info["lifted"]))
        failure = _ending(env, physics_env, terminated)
    if watch is not None and is_over:
        watch(env, policy)
    away = np.linalg.norm(_positions(physics_env) - positions, axis=1) > MOVED
    target = physics_env.target_slot
    away[target : target + 1] = False
    lifted = bool(info["lifted"])
    clean = lifted and not info["num_fallen"] and not info["num_disturbed"] if is_retrieval else info["is_success"]
    return Score(
        seed=scene if isinstance(scene, int) else scene.seed,
        clean=bool(clean),
        lifted=lifted,
        steps=steps,
        sim_s=float(physics_env.data.time),
        moved=int(away.sum()),
        cleared=int(info["num_cleared"]),
        disturbed=int(info["num_disturbed"]),
        fallen=int(info["num_fallen"]),
        refused=int(info.get("num_refused", 0)),
        failure="" if clean else "not clean" if lifted else failure,
        wall_s=time.perf_counter() - started,
    )


def held_out_seeds(count: int, first: int = HELD_OUT) -> range:
    """Seeds on which nothing is trained."""
    return range(first, first + count)


def success_rate(env: gym.Env, policy: AnyPolicy, seeds: Sequence[int], max_steps: int | None = None) -> float:
    """Share of the episodes on the scenes of some seeds that succeed, within `max_steps` each."""
    return float(np.mean([play_scene(seed, env, policy, max_steps).clean for seed in seeds]))


def _ending(env: gym.Env, physics_env: Any, terminated: bool) -> str:
    if physics_env.target_slot >= 0 and physics_env.measurements.is_off[physics_env.target_slot]:
        return "target lost"
    if not terminated:
        return "time limit"
    return "object fallen" if physics_env is env.unwrapped else "budget spent"


def _positions(physics_env: Any) -> NDArray[np.float64]:
    """Centres (n, 3) [m] of the objects in the simulation."""
    return np.array(physics_env.measurements.poses[:, :3])
