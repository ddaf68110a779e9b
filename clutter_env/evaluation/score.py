"""One episode of a policy, and its score: the same for all commands, and during training."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.goal import GoalEnv
from clutter_env.errors import ActionError
from clutter_env.policies.playing import played
from clutter_env.policies.protocol import AnyPolicy, begin_episode
from clutter_env.policies.registry import PolicyTraits

MOVED = 0.05
"""[m] An object that ends farther than this from its initial position has been moved."""

_PRESSING = ("furniture_force", "self_force", "furniture_impulse", "self_impulse", "total_slide")
"""Entries of the info, in the order of the fields."""

Watch = Callable[[gym.Env[Any, Any], AnyPolicy], None]
"""Called with the environment and the policy after the reset and after every step of an episode."""


class PolicyCrashed(RuntimeError):
    """A policy raised an exception in another process, its process died, or it returned no valid action."""


@dataclass(frozen=True)
class Score:
    """The score of one episode.

    Attributes:
        seed: of the scene.
        clean: success, as the environment's info says at the end.
        lifted: the target was lifted, or the goal of Rearrange reached, whatever else has moved.
        steps: of the environment: control steps, or skills.
        sim_s: simulated time [s].
        moved: number of objects other than the target that were carried, or ended elsewhere. See `MOVED`. What rides in
            a drawer has not moved for that.
        cleared, disturbed, fallen: numbers of objects, see `clutter_env.envs`.
        furniture_force, self_force: the robot's largest mean force over 0.1 s on the furniture, and on itself and the
            ground [N].
        furniture_impulse, self_impulse: its largest impulse beyond 50 N on these [N s].
        total_slide: by which all of these forces together would slide a table of 10 kg [m].
        total_path: moved by all objects that need not move for the goal, while not carried [m].
        skills, refused: numbers of skills tried, and of those that the motion layer refused. 0 for policies that do not
            act by skills.
        failure: "" for success, else why not.
        wall_s: wall time [s], with planning and the policy's inference.
        opened: number of drawers and doors that ended open.
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
    furniture_force: float
    self_force: float
    furniture_impulse: float
    self_impulse: float
    total_slide: float
    total_path: float
    skills: int
    refused: int
    failure: str
    wall_s: float
    opened: int = 0

    CRASHED: ClassVar[str] = "crashed: "
    """With which the failure of an episode begins that an exception of the policy has ended."""

    @classmethod
    def of_crash(cls, seed: int, cause: str) -> Score:
        """The score of a policy that raised an exception: a failed episode."""
        pressing = (0.0, 0.0, 0.0, 0.0, 0.0)
        return cls(seed, False, False, 0, 0.0, 0, 0, 0, 0, *pressing, 0.0, 0, 0, f"{cls.CRASHED}{one_line(cause)}", 0.0)

    @property
    def is_crash(self) -> bool:
        """Whether the policy raised an exception."""
        return self.failure.startswith(self.CRASHED)


def play_scene(
    scene: Any, env: gym.Env, policy: AnyPolicy, max_steps: int | None = None, watch: Watch = lambda *_: None
) -> Score:
    """Play one episode. It ends when the target has been lifted, or the goal of Rearrange reached, cleanly or not. It
    also ends when this is no longer possible, the policy gives up, or time is up.

    In Reach and Pick an episode ends with its time alone.

    Args:
        scene: one with a `seed` and a `reset(env)`, see `clutter_env.evaluation.scenes`, or the seed with which the
            environment draws it.
        env: an environment of that scene.
        policy: that plays it.
        max_steps: after which the episode is cut off, if the environment does not end it before.
        watch: called after the reset and after every step.

    Raises:
        SuiteError: the first state is not the one that the suite was made with.
        PolicyError: the policy is not made for this environment.
        PolicyCrashed: it returned no valid action.
    """
    started = time.perf_counter()
    observation, info = env.reset(seed=scene) if isinstance(scene, int) else scene.reset(env)
    physics_env: Any = getattr(env.unwrapped, "physics_env", env.unwrapped)  # Skill contains one
    ends_lifted, target = not isinstance(physics_env, GoalEnv), physics_env.target_slot
    initial = _positions(physics_env)
    begin_episode(policy, info, env)
    watch(env, policy)
    steps, is_over, terminated = 0, False, False
    carried = set[int]()
    for step in played(policy, partial(_step, env, policy), observation):
        steps, info, terminated = steps + 1, step.info, step.terminated
        # A lifted target is a success or can never become one; so is a goal that has been reached.
        is_over = step.is_over or steps == max_steps or (ends_lifted and bool(info["lifted"]))
        carried.update(physics_env.measurements.grip.carried)
        watch(env, policy)
        if is_over:
            break
    is_moved = np.linalg.norm(_positions(physics_env) - initial, axis=1) > MOVED
    is_moved[list(carried)] = True  # an object that is put down near where it stood is a pick of the lower bound
    is_moved[target : target + 1] = False
    if info["is_success"]:
        failure = ""
    elif info["lifted"]:
        failure = "not clean"
    elif not is_over:
        failure = one_line(getattr(policy, "failure", "")) or "gave up"
    elif target >= 0 and physics_env.measurements.is_off[target]:
        failure = "target lost"
    elif not terminated:
        failure = "time limit"
    else:
        failure = "object fallen" if physics_env is env.unwrapped else "budget spent"
    return Score(
        seed=scene if isinstance(scene, int) else scene.seed,
        clean=bool(info["is_success"]),
        lifted=bool(info["lifted"]),
        steps=steps,
        sim_s=float(physics_env.data.time),
        moved=int(is_moved.sum()),
        cleared=int(info["num_cleared"]),
        disturbed=int(info["num_disturbed"]),
        fallen=int(info["num_fallen"]),
        **{name: float(info[name]) for name in _PRESSING},
        total_path=float(info["total_path"]),
        skills=steps if physics_env is not env.unwrapped else 0,
        refused=int(info.get("num_refused", 0)),
        failure=failure,
        wall_s=time.perf_counter() - started,
        opened=int(info.get("num_opened", 0)),
    )


def _positions(physics_env: Any) -> NDArray[np.float64]:
    """(n, 3) Positions of the objects [m], of those in a drawer as if it were shut."""
    measurements, world = physics_env.measurements, physics_env.world
    positions = np.array(measurements.poses[:, :3])
    for number, shift in enumerate(world.drawer_shifts):
        positions[world.are_in_drawer(measurements, number), 0] -= shift
    return positions


def _step(env: gym.Env, policy: AnyPolicy, action: Any) -> tuple[Any, ...]:
    """Step the environment. Raises `PolicyCrashed` for an invalid action."""
    try:
        return env.step(action)
    except ActionError as problem:  # the traceback shows nothing of the policy's own code
        traits = getattr(policy, "traits", None)  # of its process
        place = (traits if isinstance(traits, PolicyTraits) else PolicyTraits.of(policy)).place
        raise PolicyCrashed(f"{place} returned no valid action: {problem}") from problem


def one_line(text: Any) -> str:
    """A policy's description of itself for a table: one line, at most 200 printable characters."""
    words = " ".join(str(text).split())
    return "".join(sign if sign.isprintable() and sign != "|" else "?" for sign in words[:200])


def success_rate(env: gym.Env, policy: AnyPolicy, seeds: Sequence[int], max_steps: int | None = None) -> float:
    """Share of the episodes on the scenes of some seeds that succeed, within `max_steps` each."""
    return float(np.mean([play_scene(seed, env, policy, max_steps).clean for seed in seeds]))
