"""Motions that are demonstrated: all steps that lead to one contact and away from it, of episodes or of plans.

Without physics a plan of the planner is what a robot would show that follows it exactly.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle, groupby
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.data.episode import CONTACT_SKILLS, Episode, StepLabels
from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.policies.motion.arm import ArmKinematics
from clutter_env.policies.parsed_observation import ParsedObservation, parse_observation, planar_pose
from planners import (
    CONTROL_STEP,
    Body,
    BoundAction,
    Contact,
    Planner,
    Scene,
    SceneError,
    Solution,
    contact_of,
    label_of,
)

Array = NDArray[np.float64]

_ROW = OBSERVATION_LAYOUT["objects"]
_SHOWN: Mapping[str, tuple[str, ...]] = MappingProxyType({"all": ("all", "side", "tilted", "top", "all", "tilted")})
"""Grasp sets of the plans that show a grasp set, in turn: among all grasps a plan takes level ones wherever it can."""


@dataclass(frozen=True, eq=False)
class Motion:
    """T steps of a demonstration that belong to one pick or place.

    Attributes:
        contact: the pick or place; its object is nameless.
        index: of the object's row in the observations.
        seen: the observations before the actions, and of the one after the last: (T + 1, ...).
        actions: (T, 12) "joint" actions.
        phases: names (T).
        keyframes: (T, 12) base, torso and arm, finger position at the end of each step's phase.
    """

    contact: Contact
    index: int
    seen: ParsedObservation
    actions: Array
    phases: tuple[str, ...]
    keyframes: Array

    def runs(self) -> Iterator[tuple[str, slice]]:
        """Each phase, and its steps."""
        start = 0
        for phase, steps in groupby(self.phases):
            end = start + len(list(steps))
            yield phase, slice(start, end)
            start = end


def motions_of(episodes: Iterable[Episode]) -> Iterator[Motion]:
    """The motions of demonstrations, in order."""
    for episode in episodes:
        yield from cut(episode.observations, episode.actions, episode.labels)


def cut(observations: Mapping[str, NDArray[Any]], actions: NDArray[Any], labels: StepLabels) -> Iterator[Motion]:
    """The motions of an episode of T steps; steps without a contact are left out.

    Args:
        observations: (T + 1, ...) by name.
        actions: (T, 12).
        labels: of the T actions.
    """
    keys = [
        (int(skill), int(index), base.tobytes(), tcp.tobytes())
        for skill, index, base, tcp in zip(
            labels.skill, labels.object, labels.contact_base, labels.contact_tcp, strict=True
        )
    ]
    start = 0
    for (skill, index, *_), group in groupby(keys):
        end = start + len(list(group))
        if index >= 0:
            yield Motion(
                contact=Contact(CONTACT_SKILLS[skill], "", labels.contact_base[start], labels.contact_tcp[start]),
                index=index,
                seen=parse_observation({name: values[start : end + 1] for name, values in observations.items()}),
                actions=np.asarray(actions[start:end], float),
                phases=labels.phases[start:end],
                keyframes=labels.keyframe[start:end],
            )
        start = end


def planned_motions(env: gym.Env[Any, Any], grasps: str, seeds: Iterable[int]) -> Iterator[Motion]:
    """The motions of canonical plans for the scenes of some seeds; nothing is simulated.

    Args:
        env: `clutter_env/Retrieve-…`; scenes are drawn in it.
        grasps: name of the grasp set that is shown.
        seeds: of the scenes; one without a plan is left out.
    """
    robot: RobotSpec = env.get_wrapper_attr("robot")
    planners = {name: Planner(robot, grasps=name, canonical=True) for name in _SHOWN.get(grasps, (grasps,))}
    for seed, name in zip(seeds, cycle(_SHOWN.get(grasps, (grasps,))), strict=False):
        try:
            solution = planners[name].solve(*_drawn_scene(env, seed))
        except SceneError:
            continue
        if isinstance(solution, Solution):
            yield from motions_of_plan(solution)


def _drawn_scene(env: gym.Env[Any, Any], seed: int) -> tuple[Scene, str]:
    """The scene of a seed, and its target."""
    _, info = env.reset(seed=seed)
    own: Any = env.unwrapped
    scene = Scene.from_mujoco(own.model, own.data, own.robot, movable=own.object_names, support=own.support_name)
    return scene, str(info["target"])


def motions_of_plan(solution: Solution) -> Iterator[Motion]:
    """The motions of a plan, one for each contact, in order of time.

    Observations show the robot where the plan has it, and of the objects only the one of the contact, where it is when
    the last action of the motion begins: it is row 0.
    """
    before: list[BoundAction] = []
    for action in solution.actions:
        before.append(action)
        contact = contact_of(action)
        if contact is not None:
            yield _motion(before, contact)
            before = []


def _motion(actions: Sequence[BoundAction], contact: Contact) -> Motion:
    """The motion of the actions that lead to a contact, which is that of the last one."""
    scene = actions[-1].scene
    robot, states, phases, keyframes = scene.robot, [], [], []
    for action in actions:
        trajectory = action.trajectory
        times = CONTROL_STEP * np.arange(max(int(np.ceil(trajectory.duration / CONTROL_STEP - 1e-9)), 1))
        for time in times:
            sample, label = trajectory.sample(float(time)), label_of(trajectory, float(time), contact)
            states.append(np.concatenate((sample.base, sample.q, (sample.finger_position,))))
            phases.append(label.phase)
            keyframes.append(label.keyframe)
    states.append(keyframes[-1])
    return Motion(
        contact=contact,
        index=0,
        seen=_observations(robot, np.array(states), scene.body(contact.object)),
        actions=np.zeros((len(phases), 12)),
        phases=tuple(phases),
        keyframes=np.array(keyframes),
    )


def _observations(robot: RobotSpec, states: Array, body: Body) -> ParsedObservation:
    """Observations of an object at states (t, 12) of base, torso and arm, finger position."""
    base, q = states[:, :3], states[:, 3:11]
    position, rotation = ArmKinematics(robot).tcp(torch.tensor(q, dtype=torch.float32))
    base_tcp = np.tile(np.eye(4), (len(states), 1, 1))
    base_tcp[:, :3, :3], base_tcp[:, :3, 3] = rotation.numpy(), position.numpy()
    width = np.array([robot.opening(float(finger)) for finger in states[:, 11]])
    return ParsedObservation(
        base=base,
        q=q,
        velocity=np.zeros((len(states), 11)),
        base_tcp=base_tcp,
        widths=np.column_stack((width, width)),
        objects=np.stack([_row(np.linalg.inv(T), body)[None] for T in planar_pose(base)]),
    )


def _row(T_base_world: Array, body: Body) -> Array:
    """(14,) The row of an object in the base's frame, with position, size and presence."""
    row = np.zeros(_ROW.size)
    row[_ROW.index("present")] = 1.0
    row[_ROW["position"]] = T_base_world[:3, :3] @ body.position + T_base_world[:3, 3]
    row[_ROW["half_extents"]] = body.half_extents
    row[_ROW.index("is_box")] = float(body.shape == "box")
    return row
