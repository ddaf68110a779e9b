"""Examples for the keyframe network: situations of demonstrated motions, and the keyframes that belong to them.

A motion is all steps that lead to one pick or place and away from it, of an episode or of a plan: without physics a
plan is what a robot would show that follows it exactly.

Under a shelf the planner's straight lines are drives of the base: from outside with the arm rigid, straight in
("enter"), then along the gripper to the contact ("reach"); then back along the gripper ("back") and straight out
("leave"). Such lines are cut at their corners into phases; see `planners.drive_out`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import cycle, groupby
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.data.episode import CONTACT_SKILLS, Episode
from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.errors import DatasetError
from clutter_env.policies.motion.arm import ArmKinematics, nearest_home
from clutter_env.policies.motion.network import (
    ELSEWHERE,
    FREE_JOINTS,
    LINES,
    TOWARDS,
    contact_in_base,
    line_distance,
    network_input,
    phase_index,
)
from clutter_env.policies.parsed_observation import ParsedObservation, parse_observation, planar_pose, wrapped
from clutter_env.training.grasp_labels import scene_of
from planners import (
    BACK,
    CONTROL_STEP,
    Body,
    BoundAction,
    Contact,
    Planner,
    SceneError,
    Solution,
    contact_of,
    heading,
    label_of,
)
from scripts.shipped_weights.descent import ExampleArrays

Array = NDArray[np.float64]

_AT_CONTACT = ("transit", *LINES, "close", "open")
"""Phases whose arm configuration is that of the contact or of a straight line from it: it moves with the contact."""
_TO_CONTACT = (*TOWARDS, "reach")
"""Phases at whose end the gripper is at the contact."""
_PARTS = {
    "approach": ("enter", "reach", "reach"),
    "lower": ("enter", "reach", "lower"),
    "lift": ("leave", "back", "lift"),
    "rise": ("leave", "back", "back"),
}
"""Parts of a straight line under a shelf: the base outside, around the contact, and at it."""
_END_REPEATS = 5
"""Examples of the end of a straight line, where accuracy matters most, for one of every step on it."""
_MOVED = 0.005
"""[m] from the contact's base pose from which on the base is on a drive: a measured base is not exact."""
_RIGID = 0.02
"""[m], [rad] by which torso and arm move at most on a drive with the arm rigid: measured ones are not exact."""
_ROW = OBSERVATION_LAYOUT["objects"]
_SHOWN: Mapping[str, tuple[str, ...]] = MappingProxyType({"all": ("all", "side", "tilted", "top", "all", "tilted")})
"""Grasp sets of the plans that show a grasp set, in turn: among all grasps a plan takes level ones wherever it can."""


@dataclass(frozen=True, eq=False)
class KeyframeExamples(ExampleArrays):
    """k situations and their keyframes.

    Attributes:
        features: (k, f) see `network_input`.
        phase: (k,) number of the phase.
        base: (k, 3) where the base is to stand, in its frame at the contact: x, y [m], yaw [rad]; 0 under a shelf.
        q: (k, 8) torso [m] and arm [rad], angles within a turn of home.
        finger: (k,) [m] position of one finger.
        length: (k,) [m] of the straight line, 0 in other phases.
        at_contact: (k,) whether the keyframe moves with the contact.
    """

    features: Array
    phase: NDArray[np.int64]
    base: Array
    q: Array
    finger: Array
    length: Array
    at_contact: NDArray[np.bool_]


def keyframe_examples(robot: RobotSpec, motions: Iterable[Motion], is_under_shelf: bool = False) -> KeyframeExamples:
    """The examples of all phases that are learned; motions under a shelf have been cut at corners.

    Raises:
        DatasetError: there are none.
    """
    parts: list[KeyframeExamples] = []
    for motion in motions:
        free = free_joints_of(robot, motion)
        for phase, steps in motion.runs():
            number = phase_index(motion.contact.skill, phase)
            if number is not None and free is not None and not (is_under_shelf and phase in ELSEWHERE):
                parts.append(_of_phase(robot, motion, phase, number, steps, None if is_under_shelf else free))
    if not parts:
        raise DatasetError("the demonstrations show no contact; collect them with `clutter-env collect --canonical`")
    return KeyframeExamples.joined(parts)


def free_joints_of(robot: RobotSpec, motion: Motion) -> Array | None:
    """(2,) torso [m] and upper-arm roll [rad] at the contact, less those of home; None if it was not reached."""
    ends = [motion.keyframes[steps.stop - 1] for phase, steps in motion.runs() if phase in _TO_CONTACT]
    return _free_joints(robot, ends[-1][3:11]) if ends else None


def _free_joints(robot: RobotSpec, q: Array) -> Array:
    """(..., 2) of configurations (..., 8)."""
    joints = list(FREE_JOINTS)
    return np.asarray(nearest_home(robot, q)[..., joints] - np.array(robot.in_front)[joints])


def _of_phase(
    robot: RobotSpec, motion: Motion, phase: str, number: int, steps: slice, free: Array | None
) -> KeyframeExamples:
    """The keyframe of one phase; of a straight line of the arm also the configurations on it.

    `free` (2,) are the free joints at the contact; None under a shelf, where each keyframe has its own.
    """
    contact, keyframe, is_under_shelf = motion.contact, motion.keyframes[steps.stop - 1], free is None
    base, q = keyframe[None, :3], keyframe[None, 3:11]
    distance, length = np.zeros(1), 0.0
    if phase in LINES:
        on_line = _at(motion.seen, steps)
        far = on_line if phase in TOWARDS else _at(motion.seen, slice(steps.stop, steps.stop + 1))
        length = float(line_distance(far, contact).max())
        last = np.zeros(1) if phase in TOWARDS else np.array([length])
        base = np.concatenate((on_line.base, np.repeat(base, _END_REPEATS, axis=0)))
        q = np.concatenate((on_line.q, np.repeat(q, _END_REPEATS, axis=0)))
        distance = np.concatenate((line_distance(on_line, contact), np.repeat(last, _END_REPEATS)))
    count = len(q)
    # On a line the base has arrived: the contact in its measured frame fits the measured configuration.
    # Under a shelf all is in the frame of the base at the contact; where else the base stands is geometry.
    frame = np.broadcast_to(contact.base, base.shape) if phase == "drive" or is_under_shelf else base
    base_tcp, sizes = contact_in_base(contact.tcp, frame), motion.seen.sizes(motion.index)[0]
    return KeyframeExamples(
        features=network_input(number, base_tcp, sizes, distance, _free_joints(robot, q) if free is None else free),
        phase=np.full(count, number),
        base=np.zeros((count, 3)) if is_under_shelf else _relative(base, contact.base),
        q=nearest_home(robot, q),
        finger=np.full(count, keyframe[11]),
        length=np.full(count, length),
        at_contact=np.full(count, phase in _AT_CONTACT),
    )


def _at(seen: ParsedObservation, steps: slice) -> ParsedObservation:
    """Some steps of an episode."""
    names = [entry.name for entry in fields(ParsedObservation)]
    return ParsedObservation(**{name: getattr(seen, name)[steps] for name in names})


def _relative(base: Array, origin: Array) -> Array:
    """(k, 3) bases in the frame of another one (3,)."""
    T = np.linalg.inv(planar_pose(origin))
    position = base[:, :2] @ T[:2, :2].T + T[:2, 3]
    return np.column_stack((position, wrapped(base[:, 2] - origin[2])))


def is_driven(motion: Motion) -> bool:
    """Whether the base drives on the straight lines of a motion with the arm rigid: there is a shelf above the contact.

    In the open, plans that are not canonical begin a line while the base still drives, and the arm moves meanwhile.
    """
    for phase, steps in motion.runs():
        if phase in LINES:
            distance, q = _distance(motion, steps), motion.seen.q[steps]
            is_rigid = np.abs(q - q[distance.argmax()]).max(axis=1) < _RIGID
            if np.ptp(distance[is_rigid]) > BACK:
                return True
    return False


def cut_at_corners(motion: Motion) -> Motion:
    """The motion with the phases of `SHELF_PHASES`, and keyframes at the corners of its drives."""
    phases, keyframes = list(motion.phases), np.array(motion.keyframes)
    before = keyframes[0]
    for phase, steps in motion.runs():
        end = motion.keyframes[steps.stop - 1]
        if phase in LINES:
            # On drives the arm is rigid: as it was when the drive in began, or as it is when the drive out ends.
            corner = np.array(before if phase in TOWARDS else end)
            corner[:3] = motion.contact.base
            for step, distance in zip(range(steps.start, steps.stop), _distance(motion, steps), strict=True):
                name = _PARTS[phase][0 if distance > BACK + _MOVED else 1 if distance > _MOVED else 2]
                phases[step], keyframes[step] = name, end if name in ("leave", "lower") else corner
                if name in ("enter", "back"):
                    keyframes[step, :2] -= BACK * heading(motion.contact.tcp)
        before = end
    return replace(motion, phases=tuple(phases), keyframes=keyframes)


def _distance(motion: Motion, steps: slice) -> Array:
    """(n,) [m] of the base from where it stands at the contact."""
    return np.asarray(np.linalg.norm(motion.seen.base[steps, :2] - motion.contact.base[:2], axis=1))


@dataclass(frozen=True, eq=False)
class Motion:
    """T steps of a demonstration that belong to one pick or place.

    Attributes:
        contact: the pick or place; its object is nameless.
        index: of the object's row in the observations.
        seen: the observations before the actions, and of the one after the last: (T + 1, ...).
        phases: names (T).
        keyframes: (T, 12) base, torso and arm, finger position at the end of each step's phase.
    """

    contact: Contact
    index: int
    seen: ParsedObservation
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
    """The motions of demonstrations, in order; steps that belong to no pick or place are left out."""
    for episode in episodes:
        labels, start = episode.labels, 0
        columns = (labels.skill, labels.object, labels.contact_base, labels.contact_tcp)
        keys = [tuple(value.tobytes() for value in row) for row in zip(*columns, strict=True)]
        for _, group in groupby(keys):
            steps = slice(start, start + len(list(group)))
            if labels.object[start] >= 0:
                observations = {
                    name: values[steps.start : steps.stop + 1] for name, values in episode.observations.items()
                }
                yield Motion(
                    contact=Contact(
                        CONTACT_SKILLS[labels.skill[start]], "", labels.contact_base[start], labels.contact_tcp[start]
                    ),
                    index=int(labels.object[start]),
                    seen=parse_observation(observations),
                    phases=labels.phases[steps],
                    keyframes=labels.keyframe[steps],
                )
            start = steps.stop


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
            _, info = env.reset(seed=seed)
            solution = planners[name].solve(scene_of(env), info["target"])
        except SceneError:
            continue
        if isinstance(solution, Solution):
            yield from motions_of_plan(solution)


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
    T_base_world = np.linalg.inv(planar_pose(base))
    objects = np.zeros((len(states), 1, _ROW.size))
    objects[..., _ROW.index("present")] = 1.0
    objects[:, 0, _ROW["position"]] = T_base_world[:, :3, :3] @ body.position + T_base_world[:, :3, 3]
    objects[..., _ROW["half_extents"]] = body.half_extents
    objects[..., _ROW.index("is_box")] = float(body.shape == "box")
    return ParsedObservation(
        base=base,
        q=q,
        velocity=np.zeros((len(states), 11)),
        base_tcp=base_tcp,
        widths=np.column_stack((width, width)),
        objects=objects,
    )
