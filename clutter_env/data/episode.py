"""One episode, recorded while an expert acts: observations, actions, physics states, and labels of the steps.

Its columns give name, unit and meaning of every number.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import gymnasium as gym
import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.envs.observation import Column, EntryLayout
from clutter_env.errors import StateError
from clutter_env.policies.experts import Expert
from clutter_env.policies.playing import played
from clutter_env.policies.protocol import begin_episode
from clutter_env.provenance import provenance
from clutter_env.simulation.control import STILL
from clutter_env.task import Task

if TYPE_CHECKING:
    from planners import StepLabel

PHYSICS_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
"""Time, positions, velocities, activations: the state with which `mj_setState` restores a step."""
CONTACT_SKILLS = ("", "pick", "place")
"""Meaning of the numbers of `StepLabels.skill`."""
_KEYFRAME = 12
"""Length of a keyframe: base (3), torso and arm (8), finger position."""


@dataclass(frozen=True, eq=False)
class StepLabels:
    """The labels of T steps, one row each. Without a pick-place action numbers are NaN and indices -1.

    Attributes:
        phases: names (T) of the phase of the motion, "" while the robot waits, see `planners.StepLabel`.
        skill: (T,) index into `CONTACT_SKILLS` of the pick-place action before or after which the phase comes.
        object: (T,) index of the object that is picked or placed, as in the observation.
        contact_base: (T, 3) x [m], y [m], yaw [rad] of the base when the object is grasped or released, in the world.
        contact_tcp: (T, 4, 4) TCP pose then, in the world.
        keyframe: (T, 12) base, torso and arm [m, rad], finger position [m] at the end of the phase. NaN for experts
            without a plan.
    """

    phases: tuple[str, ...]
    skill: NDArray[np.int64]
    object: NDArray[np.int64]
    contact_base: NDArray[np.float64]
    contact_tcp: NDArray[np.float64]
    keyframe: NDArray[np.float64]

    @classmethod
    def of(cls, labels: Sequence[StepLabel | None], objects: Sequence[str]) -> StepLabels:
        """Labels of an expert's steps, None entries where it has none. `objects` are named as in the observation."""
        contacts = [None if label is None else label.contact for label in labels]
        no_base, no_tcp, no_keyframe = (np.full(shape, np.nan) for shape in (3, (4, 4), _KEYFRAME))
        keyframes = [no_keyframe if label is None else label.keyframe for label in labels]
        return cls(
            tuple("" if label is None else label.phase for label in labels),
            np.array([CONTACT_SKILLS.index(one.skill if one else "") for one in contacts], np.int64),
            np.array([objects.index(one.object) if one else -1 for one in contacts], np.int64),
            np.array([one.base if one else no_base for one in contacts], np.float64).reshape(-1, 3),
            np.array([one.tcp if one else no_tcp for one in contacts], np.float64).reshape(-1, 4, 4),
            np.array(keyframes, np.float64).reshape(-1, _KEYFRAME),
        )

    def __len__(self) -> int:
        return len(self.phases)


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode of T steps.

    Attributes:
        task: environment and keyword arguments.
        seed: given to reset. Seed, `options` and `actions` determine everything else.
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
        skills: names (T) of the skill of each action.
        labels: phase, pick-place action and keyframe of each of the T actions.
        columns: names and units of all numbers, by the array's name in the episode's file.
        plan: the expert's plan as text.
        report: the expert's report, JSON values.
        provenance: version, commit, packages and environment digest, see `clutter_env.provenance`.
        saved_states: of all T + 1 states, from `save_state`. `reset(options={"state": …})` continues an episode from
            them. Empty if the state cannot be saved, and for older files.
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
    saved_states: tuple[bytes, ...] = ()

    @property
    def succeeded(self) -> bool:
        """Whether the last step's info reports success."""
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
    observations, infos, states, saved = [observation], [info], [physics_state(env)], [saved_state(env)]
    actions: list[NDArray[np.float32]] = []
    rewards: list[float] = []
    skills: list[str] = []
    labels: list[StepLabel | None] = []
    terminated = truncated = False
    for step in played(expert, lambda action: env.step(np.asarray(action, np.float32)), observation):
        skills.append(expert.skill)
        labels.append(expert.step_label)
        actions.append(np.asarray(step.action, np.float32))
        rewards.append(float(step.reward))
        observations.append(step.observation)
        infos.append(step.info)
        states.append(physics_state(env))
        saved.append(saved_state(env))
        terminated, truncated = step.terminated, step.truncated
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
        saved_states=tuple(saved) if all(saved) else (),
    )


def physics_state(env: gym.Env) -> NDArray[np.float64]:
    """MuJoCo's full physics state (s,)."""
    model, data = env.get_wrapper_attr("model"), env.get_wrapper_attr("data")
    state = np.empty(mujoco.mj_stateSize(model, PHYSICS_STATE))
    mujoco.mj_getState(model, data, state, PHYSICS_STATE)
    return state


def saved_state(env: gym.Env) -> bytes:
    """Full simulator and controller state, see `BaseEnv.save_state`. Empty if it cannot be saved."""
    try:
        return bytes(env.get_wrapper_attr("save_state")())
    except StateError:
        return b""


class Columns(NamedTuple):
    """Description of one array of an episode, which has one row per step.

    Attributes:
        about: the meaning of a row, in words.
        names: of the numbers of a row, flattened. Empty for images and for MuJoCo's own state.
        units: of each of these numbers, "" without a unit.
    """

    about: str
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()


_POSE = tuple(f"tcp_{row}{column}" for row in "0123" for column in "0123")
_POSE_UNITS = tuple("m" if column == 3 and row < 3 else "" for row in range(4) for column in range(4))


def episode_columns(env: gym.Env, observation: Mapping[str, Any]) -> dict[str, Columns]:
    """Columns of every array of an episode in this environment, by its name in the file.

    Args:
        env: in which the episode is recorded.
        observation: any observation of the environment.
    """
    robot: RobotSpec = env.get_wrapper_attr("robot")
    layout: Mapping[str, EntryLayout] = env.get_wrapper_attr("observation_layout")
    found = {f"observations/{name}": _observation(name, layout, value) for name, value in observation.items()}
    joints = [link.joint.removesuffix("_joint") for link in robot.chain]
    keyframe = ("base_x", "base_y", "base_yaw", *joints, "finger_position")
    keyframe_units = ("m", "m", "rad", "m", *["rad"] * (len(joints) - 1), "m")
    before = "row t belongs to observation t and action t, the last row to no action"
    action = f"pick-place action that the phase leads to or comes from: 0 none, 1 pick, 2 place; {before}: 0"
    singles = {
        "rewards": ("reward", "reward of the step"),
        "terminations": ("terminated", "whether the step ended the episode by success or failure"),
        "truncations": ("truncated", "whether the step ended the episode early"),
        "infos/is_success": ("is_success", "info is_success, that of reset first"),
        "infos/num_fallen": ("num_fallen", "info num_fallen, that of reset first"),
        "infos/num_disturbed": ("num_disturbed", "info num_disturbed, that of reset first"),
        "infos/skill": ("skill", f"index into expert/skills; {before}: -1"),
        "infos/phase": ("phase", f"phase of the motion, index into expert/phases; {before}: -1"),
        "infos/contact_skill": ("skill", action),
        "infos/contact_object": ("object", f"index of its object as in the observation; {before}; -1 without one"),
    }
    found |= {name: Columns(about, (column,), ("",)) for name, (column, about) in singles.items()}
    control_mode, has_base = str(env.get_wrapper_attr("control_mode")), "observation" not in layout
    return found | {
        "actions": _action(control_mode, joints, has_base, robot.base_drive),
        "infos/state": Columns("MuJoCo's mjSTATE_FULLPHYSICS, that after reset first; for mj_setState"),
        "infos/contact_base": Columns(
            f"base pose at the grasp or release, in the world; {before}; NaN without one",
            ("base_x", "base_y", "base_yaw"),
            ("m", "m", "rad"),
        ),
        "infos/contact_tcp": Columns(
            f"T_world_tcp (4, 4) at the grasp or release; {before}; NaN without one", _POSE, _POSE_UNITS
        ),
        "infos/keyframe": Columns(
            f"whole-body configuration at the end of the phase; {before}; NaN without a plan", keyframe, keyframe_units
        ),
    }


def _observation(name: str, layout: Mapping[str, EntryLayout], value: Any) -> Columns:
    """Columns of one entry of an observation."""
    if name in ("achieved_goal", "desired_goal"):
        about = "from the TCP at the start, along the base's axes" if "observation" in layout else "in the world"
        return Columns(f"{name.partition('_')[0]} point {about}", ("x", "y", "z"), ("m", "m", "m"))
    if name == "observation" and name not in layout:
        rows = (len(value) - sum(layout[entry].size for entry in _OWN)) // layout["objects"].size
        parts = [column._replace(name=f"{entry}.{column.name}") for entry in _OWN for column in layout[entry].columns]
        return _named(
            "the entries robot, tcp, gripper and objects, one after the other",
            [*parts, *_rows(layout, "objects", rows)],
        )
    if name in ("objects", "goals"):
        rows = len(value) // layout[name].size
        return _named("one row of each object, one after the other", _rows(layout, name, rows))
    if name in layout:
        return _named(f"observation entry {name}, relative to the base", layout[name].columns)
    return Columns(f"image {name}")


_OWN = ("robot", "tcp", "gripper")


def _rows(layout: Mapping[str, EntryLayout], entry: str, rows: int) -> list[Column]:
    columns = layout[entry].columns
    return [column._replace(name=f"object_{row}.{column.name}") for row in range(rows) for column in columns]


def _named(about: str, columns: Iterable[Column]) -> Columns:
    every = tuple(columns)
    return Columns(about, tuple(column.name for column in every), tuple(column.unit for column in every))


def _action(control_mode: str, joints: list[str], has_base: bool, base_drive: str) -> Columns:
    """Columns of an action. For a fixed base they move the TCP without turning it."""
    moves = [f"tcp_velocity_{axis}" for axis in "xyz"]
    if has_base:
        turns = [f"tcp_rotation_{axis}" for axis in "xyz"]
        own = joints if control_mode == "joint" else moves + turns
        every, lacking = ("base_forward", "base_left", "base_yaw_rate"), STILL[base_drive]
        moves = [*(name for index, name in enumerate(every) if index not in lacking), *own]
    about = f"control mode {control_mode}: shares of the greatest velocity, and of the gripper's opening, -1 to 1"
    return Columns(about, (*moves, "gripper"), ("",) * (len(moves) + 1))
