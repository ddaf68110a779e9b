"""Demonstrated motions without physics: the plans of the planner, as a robot would show them that follows exactly."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import cycle
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.learning.contacts.reading import Reading, planar_pose
from clutter_env.learning.demonstrations.decision_collect import canonical_plan, drawn_scene
from clutter_env.learning.keyframes.kinematics import ArmKinematics
from clutter_env.learning.keyframes.motions import Motion
from planners import CONTROL_STEP, Body, BoundAction, Contact, Planner, Solution, contact_of, label_of

__all__ = ["motions_of_plan", "planned_motions"]

Array = NDArray[np.float64]

_ROW = OBSERVATION_LAYOUT["objects"]


_SHOWN: Mapping[str, tuple[str, ...]] = MappingProxyType({"all": ("all", "side", "tilted", "top", "all", "tilted")})
"""Grasp sets of the plans that show a grasp set, in turn: among all grasps a plan takes level ones wherever it can."""


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
        solution = canonical_plan(planners[name], *drawn_scene(env, seed))
        if solution is not None:
            yield from motions_of_plan(solution)


def motions_of_plan(solution: Solution) -> Iterator[Motion]:
    """The motions of a plan, one for each contact, in order of time.

    Readings show the robot where the plan has it, and of the objects only the one of the contact, where it is when the
    last action of the motion begins: it is row 0.
    """
    before: list[BoundAction] = []
    for action in solution.actions:
        before.append(action)
        contact = contact_of(action)
        if contact is not None:
            yield _motion(before, contact)
            before = []


def _motion(actions: Sequence[BoundAction], contact: Contact) -> Motion:
    """The motion of the actions that lead to a contact, the last of which has it."""
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
        reading=_reading(robot, np.array(states), scene.body(contact.object)),
        actions=np.zeros((len(phases), 12)),
        phases=tuple(phases),
        keyframes=np.array(keyframes),
    )


def _reading(robot: RobotSpec, states: Array, body: Body) -> Reading:
    """What observations would show of an object at states (t, 12) of base, torso and arm, finger position."""
    base, q = states[:, :3], states[:, 3:11]
    position, rotation = ArmKinematics(robot).tcp(torch.tensor(q, dtype=torch.float32))
    base_tcp = np.tile(np.eye(4), (len(states), 1, 1))
    base_tcp[:, :3, :3], base_tcp[:, :3, 3] = rotation.numpy(), position.numpy()
    width = np.array([robot.opening(float(finger)) for finger in states[:, 11]])
    return Reading(
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
