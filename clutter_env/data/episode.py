"""One episode, recorded while an expert acts: observations, actions, physics states, and what each step is part of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.data.columns import Columns, episode_columns
from clutter_env.policies.experts import Expert
from clutter_env.policies.protocol import begin_episode
from clutter_env.provenance import provenance
from clutter_env.task import Task

if TYPE_CHECKING:
    from planners import StepLabel

PHYSICS_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
"""Time, positions, velocities, activations: the state with which `mj_setState` restores a step."""
CONTACT_SKILLS = ("", "pick", "place")
"""Meaning of the numbers of `StepLabels.skill`."""
_KEYFRAME = 12
"""Numbers of a keyframe: base (3), torso and arm (8), finger position."""


@dataclass(frozen=True, eq=False)
class StepLabels:
    """The labels of T steps, one row each. Without a pick-place action numbers are NaN and indices -1.

    Attributes:
        phases: names (T) of the phase of the motion, "" while the robot waits; see `planners.StepLabel`.
        skill: (T,) index into `CONTACT_SKILLS`: of the pick-place action that the phase leads to or comes from.
        object: (T,) index of the object that is picked or placed, as in the observation.
        contact_base: (T, 3) x [m], y [m], yaw [rad] of the base when the object is grasped or released, in the world.
        contact_tcp: (T, 4, 4) TCP pose then, in the world.
        keyframe: (T, 12) base, torso and arm [m, rad], finger position [m] at the end of the phase; NaN for experts
            that have no plan.
    """

    phases: tuple[str, ...]
    skill: NDArray[np.int64]
    object: NDArray[np.int64]
    contact_base: NDArray[np.float64]
    contact_tcp: NDArray[np.float64]
    keyframe: NDArray[np.float64]

    @classmethod
    def of(cls, labels: Sequence[StepLabel | None], objects: Sequence[str]) -> StepLabels:
        """The labels of an expert's steps, None where it has none; `objects` are named as in the observation."""
        steps = len(labels)
        found = cls(
            tuple("" if label is None else label.phase for label in labels),
            np.zeros(steps, np.int64),
            np.full(steps, -1, np.int64),
            np.full((steps, 3), np.nan),
            np.full((steps, 4, 4), np.nan),
            np.full((steps, _KEYFRAME), np.nan),
        )
        for step, label in enumerate(labels):
            if label is None:
                continue
            found.keyframe[step] = label.keyframe
            if label.contact is not None:
                found.skill[step] = CONTACT_SKILLS.index(label.contact.skill)
                found.object[step] = objects.index(label.contact.object)
                found.contact_base[step], found.contact_tcp[step] = label.contact.base, label.contact.tcp
        return found

    def __len__(self) -> int:
        return len(self.phases)


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
        labels: phase, pick-place action and keyframe of each of the T actions.
        columns: names and units of all numbers, by the array's name in the episode's file.
        plan: the expert's plan as text.
        report: the expert's report, JSON values.
        provenance: version, commit, packages and environment digest; see `clutter_env.provenance`.
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
    provenance: Mapping[str, Any]

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


def record(task: Task, env: gym.Env, expert: Expert, seed: int, options: Mapping[str, Any] | None = None) -> Episode:
    """Reset with the seed and let the expert act until the episode ends or the expert is done.

    Actions are rounded to the action space's float32 before they are executed, as they are stored.
    """
    observation, info = env.reset(seed=seed, options=None if options is None else dict(options))
    begin_episode(expert, info, env)
    observations, infos, states = [observation], [info], [_physics_state(env)]
    actions: list[NDArray[np.float32]] = []
    rewards: list[float] = []
    skills: list[str] = []
    labels: list[StepLabel | None] = []
    terminated = truncated = False
    while not (terminated or truncated or expert.done):
        action = np.asarray(expert.act(observation), np.float32)
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
        provenance=provenance(env),
    )


def _physics_state(env: gym.Env) -> NDArray[np.float64]:
    model, data = env.get_wrapper_attr("model"), env.get_wrapper_attr("data")
    state = np.empty(mujoco.mj_stateSize(model, PHYSICS_STATE))
    mujoco.mj_getState(model, data, state, PHYSICS_STATE)
    return state
