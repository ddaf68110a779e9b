"""One episode: recorded while an expert acts, and replayed from its seed and actions alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.demonstrations.columns import Columns, episode_columns
from clutter_env.policies.experts import Expert
from clutter_env.learning.demonstrations.step_labels import StepLabels
from clutter_env.learning.task import Task, versions

if TYPE_CHECKING:
    from planners import StepLabel

__all__ = ["PHYSICS_STATE", "Episode", "ReplayResult", "record", "replay"]

PHYSICS_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
"""Time, positions, velocities, activations: the state with which `mj_setState` restores a step."""
_VECTOR = 2
"""Dimensions of an observation's entry over all steps, if it is no image."""


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode of T steps.

    Attributes:
        task: environment and keyword arguments.
        seed: given to reset; seed, `options` and `actions` determine everything else.
        options: given to reset.
        observations: by name, (T + 1, ...) each.
        actions: (T, n).
        rewards: (T,).
        terminated: flag of the last step.
        truncated: flag of the last step.
        is_success: (T + 1,) flags of the infos.
        num_fallen: (T + 1,) counts of the infos.
        num_disturbed: (T + 1,) counts of the infos.
        states: (T + 1, s) MuJoCo's full physics state.
        skills: names (T) of the skill that each action belongs to.
        labels: phase, contact and keyframe of each of the T actions.
        columns: names and units of all numbers, by the array's name in the episode's file.
        plan: the expert's plan as text.
        report: the expert's report, JSON values.
        versions: of all packages that the episode depends on.
    """

    task: Task
    seed: int
    options: Mapping[str, Any] | None
    observations: Mapping[str, NDArray[Any]]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float64]
    terminated: bool
    truncated: bool
    is_success: NDArray[np.bool_]
    num_fallen: NDArray[np.int64]
    num_disturbed: NDArray[np.int64]
    states: NDArray[np.float64]
    skills: tuple[str, ...]
    labels: StepLabels
    columns: Mapping[str, Columns]
    plan: str
    report: Mapping[str, Any]
    versions: Mapping[str, str]

    @property
    def succeeded(self) -> bool:
        """Whether the last step's info says success."""
        return bool(self.is_success[-1])

    @property
    def is_clean(self) -> bool:
        """Whether no object has fallen or been disturbed by the end."""
        return not self.num_fallen[-1] and not self.num_disturbed[-1]

    def __len__(self) -> int:
        return len(self.actions)


@dataclass(frozen=True)
class ReplayResult:
    """Whether a replay was identical and successful; `first_difference` is the first step that differed, or -1."""

    is_identical: bool
    is_success: bool
    first_difference: int


def record(task: Task, env: gym.Env, expert: Expert, seed: int, options: Mapping[str, Any] | None = None) -> Episode:
    """Reset with the seed and let the expert act until the episode ends or the expert is done.

    Actions are rounded to the action space's float32 before they are executed, as they are stored.
    """
    observation, info = env.reset(seed=seed, options=None if options is None else dict(options))
    expert.reset()
    observations, infos, states = [observation], [info], [_physics_state(env)]
    actions: list[NDArray[np.float32]] = []
    rewards: list[float] = []
    skills: list[str] = []
    labels: list[StepLabel | None] = []
    terminated = truncated = False
    while not (terminated or truncated or expert.done):
        action = np.asarray(expert.act(), np.float32)
        skills.append(expert.skill)
        labels.append(expert.step_label)
        observation, reward, terminated, truncated, info = env.step(action)
        actions.append(action)
        rewards.append(float(reward))
        observations.append(observation)
        infos.append(info)
        states.append(_physics_state(env))
    assert env.action_space.shape is not None
    return Episode(
        task=task,
        seed=seed,
        options=options,
        observations={name: np.stack([entry[name] for entry in observations]) for name in observations[0]},
        actions=np.array(actions, np.float32).reshape(-1, *env.action_space.shape),
        rewards=np.array(rewards),
        terminated=bool(terminated),
        truncated=bool(truncated),
        is_success=np.array([entry["is_success"] for entry in infos]),
        num_fallen=np.array([entry["num_fallen"] for entry in infos]),
        num_disturbed=np.array([entry["num_disturbed"] for entry in infos]),
        states=np.stack(states),
        skills=tuple(skills),
        labels=StepLabels.of(labels, env.get_wrapper_attr("world").names),
        columns=episode_columns(env, observations[0]),
        plan=expert.plan_text,
        report=expert.report_values,
        versions=versions(),
    )


def replay(episode: Episode) -> ReplayResult:
    """Repeat the actions in a new environment and compare observations and rewards bit for bit; images are left out."""
    env = episode.task.make()
    try:
        observation, info = env.reset(
            seed=episode.seed, options=None if episode.options is None else dict(episode.options)
        )
        if not _same(episode, 0, observation):
            return ReplayResult(False, bool(info["is_success"]), 0)
        for step, action in enumerate(episode.actions):
            observation, reward, _, _, info = env.step(action)
            if not _same(episode, step + 1, observation) or float(reward) != episode.rewards[step]:
                return ReplayResult(False, bool(info["is_success"]), step + 1)
        return ReplayResult(True, bool(info["is_success"]), -1)
    finally:
        env.close()


def _same(episode: Episode, step: int, observation: Mapping[str, NDArray[Any]]) -> bool:
    """Whether an observation equals that of a step of the episode, bit for bit."""
    vectors = {name for name, values in episode.observations.items() if values.ndim == _VECTOR}
    return observation.keys() == vectors and all(
        np.asarray(value).tobytes() == episode.observations[name][step].tobytes() for name, value in observation.items()
    )


def _physics_state(env: gym.Env) -> NDArray[np.float64]:
    model, data = env.get_wrapper_attr("model"), env.get_wrapper_attr("data")
    state = np.empty(mujoco.mj_stateSize(model, PHYSICS_STATE))
    mujoco.mj_getState(model, data, state, PHYSICS_STATE)
    return state
