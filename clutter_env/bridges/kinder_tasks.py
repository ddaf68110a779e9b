"""KinDER's manipulation tasks (TidyBot, and a Franka arm on a desk), solved through their own `step`.

with Remote("venv-kinder/bin/python", "kinder_worker.py") as kinder:
    task = KinderTask(kinder, "kinder/PickPlace3D-o1-v0", seed=0)
    expert = TampExpert(task.world, grasps=GRASPS)
    expert.reset()
    while not (expert.done or task.world.is_over):
        task.world.step(expert.act())
    print(expert.report, task.is_solved)
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from assets.robot_making import FINGERS, Mounting, make_robot
from clutter_env.bridges.kept import kept_mjcf
from clutter_env.bridges.remote import BridgeError, Remote
from planners import SIDE, AntipodalFamily, ControlledWorld, Goal, GraspFamily, Region, Scene, insert_robot
from planners.grasping.families import GRASP_SETS
from planners.scene.bodies import leans

Array = NDArray[np.float64]

_PREFIX = "robot_"
"""Of the names of KinDER's robot in the models of its tasks."""
_OPENING, _CLOSED = 0.085, 0.79
"""[m] of the gripper, and [rad] of its driver joints when it is closed."""
_STEP, _DT = 0.1, 0.1
"""[m], [rad] The largest change of a joint in one step, and [s] how long that lasts."""
_SPEED = 0.95 * _STEP / _DT
"""[m/s], [rad/s] of commands in plans at most. The rest is for corrections."""
_BESIDE = 0.01
"""[m] that the gripper may be behind beside an object: between the walls of a bin it has 4 mm to each side."""
_MARGIN = 0.01
"""[m] by which an object may be beside where it was to be put down, and still be in its region."""
_BELOW = 0.05
"""[m] that what carries a region may be below where KinDER's box for the centres of its objects begins."""
_DROP = 0.06
"""[m] that an object may fall into another one, as a bin, whose walls keep the linkage of the hand out."""
_PAD = (0.007, 0.011)
"""[m] Half of the thickness and of the width of a finger of the Robotiq 2F-85, at its tip."""
_KNUCKLE, _OUTSIDE = (-0.08, 0.0025, 0.0, 0.033), (-0.08, -0.0125, 0.042, 0.075)
"""[m] Boxes of its linkage on either side, along the approach from the pinch site and outwards. The first moves with
the finger, from its inner face on. The second does not. Together they contain all links, whatever the opening."""
_KNUCKLE_WIDTH = 0.0195
"""[m] Half of the width of the linkage."""
_SAME = 1e-6
"""[m] by which the sides of a cube may differ."""
_APART, _BACK, _MOST_BACK = 0.005, 0.02, 5
"""[m] that the base is from everything at first, [m] by which it drives back otherwise at once, and how often."""
_LOOKS, _STILL = 10, 10
"""Largest number of checks whether a leaning object has come to rest, and steps between two checks."""
_FINGER_GAP, _WIDE_GAP = 0.005, 0.012
"""[m] The arm comes to rest within 1 mm to the side of where it was told to be. But a mesh, as the carton, turns on the
spot by 1° a second, without being touched: the fingers need more room around it."""
_ANTIPODAL = tuple(family for family in GRASP_SETS["all"] if isinstance(family, AntipodalFamily))
GRASPS = (
    SIDE,
    GraspFamily("tilted 50°", np.radians(50), depth=0.02),
    *(family for family in GRASP_SETS["all"][1:] if isinstance(family, GraspFamily)),
    *(replace(family, name=f"{family.name}, straight", directions=4) for family in _ANTIPODAL),
    *_ANTIPODAL,
    *(
        GraspFamily(f"top, {1000 * offset:.0f} mm off the axis", np.pi / 2, depth=0.02, axis_offset=offset)
        for offset in (0.004, 0.008, 0.012)
    ),
)
"""TidyBot takes nothing off the floor at less than 50°, and at 60° it does not reach far into a shelf. What has faces
is held straight if it can be: the pads are 38 mm long, and a carton held aslant turns between them, and slips. The
last are for cubes that are narrower than the pads, and stand closer to each other than that."""


@dataclass(frozen=True)
class _Robot:
    """A robot of KinDER.

    Attributes:
        body: the first one, without the prefix.
        base_joints: of KinDER's, in our order, or () for an arm that stands.
        mounting: how its file becomes a robot of ours: `tool` leads from its pinch site to the middle of the finger
            pads where they hold an object of 4 cm.
        home: [m, rad] the configuration in which it starts, with the lift that ours has.
        response: (a, b): told to change by u, a joint of the arm moves by a times its last step's move and b u.
    """

    body: str
    base_joints: tuple[str, ...]
    mounting: Mounting
    home: tuple[float, ...]
    response: tuple[float, float]

    @property
    def arm_speed(self) -> float:
        """[rad/s] of the arm's joints in plans, which it keeps up with."""
        kept, followed = self.response
        return _SPEED * followed / (1 - kept)


_ROBOTS = {
    "tidybot": _Robot(
        "base_link",
        ("joint_x", "joint_y", "joint_th"),
        Mounting("base_link", "pinch_site", turn=np.pi / 2, tool=0.025, opening=_OPENING),
        (0.0005, 0.0, -0.3491, 3.1416, -2.5482, 0.0, -0.8727, 1.5708),
        (-0.6, 0.4),  # a torque of 200 u - 30 v Nm, v at the start of the step, against 50 Nm s/rad
    ),
    "fr3": _Robot(
        "base",
        (),
        Mounting(
            "fr3_link0",
            "pinch_site",
            turn=np.pi / 2,
            tool=0.033,
            opening=_OPENING,
            on=(0.0, 0.75),
            apart=("fr3_link5", "fr3_link7"),  # "default" in the SRDF of Franka: only their boxes are near
            radius=0.1,
            drive="fixed",
        ),
        (0.0005, 0.0, 0.0, 0.0, -1.57079, 0.0, 1.57079, -0.7853),
        (0.0, 0.63),  # a position servo with a damping of 0.1 s over its stiffness
    ),
}


class KinderTask:
    """One episode of a KinDER task: a `Controller` of its robot, and the world in which the expert plans.

    Attributes:
        world: for `TampExpert`, with the goal of the task.
        dt: [s] of one step.
        done: the environment has ended the episode without success.
        is_solved: what the environment's own check said after the last step.
        steps: taken so far.
    """

    dt = _DT

    def __init__(self, kinder: Remote, id: str, seed: int) -> None:
        """Reset the environment.

        Raises:
            BridgeError: there is no such task, it has another robot, or a goal that is not about places of objects.
        """
        self._kinder, self.done, self.is_solved, self.steps = kinder, False, False, 0
        start = kinder("reset", id=id, seed=seed)
        facts = start["goal"]
        if not all(fact[0] == "on" and fact[2] in start["boxes"] for fact in facts):
            raise BridgeError(f"{id} asks for {facts}; only places of objects can be planned for")
        anchors = set(start["anchors"].values())
        self._kind = _ROBOTS[start["kind"]]
        robot = made_robot(start["kind"], start["robot"], _finger_gap(start["xml"], anchors))
        base = (0.0, 0.0, 0.0) if self._kind.base_joints else start["base"]
        model = insert_robot(start["xml"], robot, base, without=[_PREFIX + self._kind.body])
        theirs = start["joints"]
        names = [*self._kind.base_joints, *robot.drive_joints[4:]]  # theirs, in our order, the lift aside
        self._theirs = np.array([theirs[_PREFIX + name] for name in names])
        self._driver = theirs[_PREFIX + "left_driver_joint"]
        ours = robot.drive_joints[: len(self._kind.base_joints)] + robot.drive_joints[4:]
        self._ours = np.array([model.joint(name).qposadr[0] for name in ours])
        self._fingers = [model.joint(name).qposadr[0] for name in robot.finger_joints]
        shared = [name for name in theirs if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) >= 0]
        joints = [(theirs[name], model.joint(name)) for name in shared]
        self._others = [(start, int(joint.qposadr[0]), 7 if int(joint.type[0]) == 0 else 1) for start, joint in joints]
        cubes = [model.joint(name) for name in shared if _is_cube(model, int(model.joint(name).bodyid[0]))]
        self._cubes = [int(joint.qposadr[0]) + 3 for joint in cubes]
        self._robot = robot
        self._qpos, self._state = model.qpos0.copy(), np.array(start["qpos"])
        self._before = self._state
        self._qpos[model.joint(robot.drive_joints[3]).qposadr[0]] = self._kind.home[0]
        free = [model.body(model.jnt_bodyid[joint]).name for joint in np.flatnonzero(model.jnt_type == 0)]
        movable = [name for name in free if name not in anchors]
        data = mujoco.MjData(model)
        self._back_off(model, data)
        scene = self._at_rest(lambda: self._look(model, data, movable))
        regions = [
            _region(scene, name, start["anchors"][name], np.array(boxes), facts)
            for name, boxes in start["boxes"].items()
        ]
        below = {scene.support_under(body).name for body in scene.objects} | {region.support for region in regions}
        first, *more = sorted(below)
        self.world = ControlledWorld(
            self,
            model,
            robot,
            movable=movable,
            support=first,
            more_supports=more,
            regions=regions,
            goal=Goal.of(facts),
            line_tolerance=_BESIDE,
        )

    def observe(self) -> Array:
        """(nq,) joint positions in our model."""
        for theirs, ours, count in self._others:
            self._qpos[ours : ours + count] = self._state[theirs : theirs + count]
        for start in self._cubes:
            self._qpos[start : start + 4] = standing(self._qpos[start : start + 4])
        self._qpos[self._ours] = self._state[self._theirs]
        opening = _OPENING * (1 - self._state[self._driver] / _CLOSED)
        self._qpos[self._fingers] = np.clip(self._robot.finger_position(opening), 0, _OPENING / 2)
        return self._qpos

    def _back_off(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Drive backwards from what the base touches: KinDER draws where it starts, up to 5 mm inside its furniture."""
        base = model.body("mobile_base").id
        own = np.flatnonzero(model.geom_bodyid == base)
        others = np.flatnonzero(
            (model.geom_contype | model.geom_conaffinity).astype(bool) & (model.body_rootid[model.geom_bodyid] != base)
        )
        while True:
            data.qpos[:] = self.observe()
            mujoco.mj_forward(model, data)
            away = (mujoco.mj_geomDistance(model, data, a, b, _APART, None) for a in own for b in others)
            if not self._kind.base_joints or self.steps == _MOST_BACK or min(away) >= _APART:
                return
            wanted = self._state[self._theirs]
            wanted[:2] -= _BACK * np.array([np.cos(wanted[2]), np.sin(wanted[2])])
            self.act(np.insert(wanted, 3, 0.0), _OPENING)

    def _look(self, model: mujoco.MjModel, data: mujoco.MjData, movable: Collection[str]) -> Scene:
        data.qpos[:] = self.observe()
        mujoco.mj_forward(model, data)
        return Scene.from_mujoco(model, data, self._robot, movable=movable, support="floor")

    def _at_rest(self, look: Callable[[], Scene]) -> Scene:
        """The observation after all objects have come to rest: after some resets a cube leans on another, and is still
        falling."""
        scene, arm = look(), len(self._kind.base_joints)
        still = self._state[self._theirs]
        still = np.concatenate((still[:arm], np.zeros(4 - arm), still[arm:]))
        for _ in range(_LOOKS):
            if not any(leans(body) for body in scene.objects):
                break
            for _ in range(_STILL):
                self.act(still, _OPENING)
            scene = look()
        return scene

    def act(self, configuration: Array, opening: float) -> None:
        """One step of the environment, by changes of joint positions."""
        arm = len(self._kind.base_joints)
        kept, followed = self._kind.response
        moved = (self._state - self._before)[self._theirs]
        change = np.append(configuration[:arm], configuration[4:]) - self._state[self._theirs]
        turns = slice(max(arm - 1, 0), None)  # the base's yaw and the arm
        change[turns] = (change[turns] + np.pi) % (2 * np.pi) - np.pi
        change[arm:] = (change - kept * moved)[arm:] / followed
        grip = np.clip(1 - opening / _OPENING, 0, 1)
        answer = self._kinder("step", action=[*np.clip(change, -_STEP, _STEP), grip])
        self._before, self._state, self.steps = self._state, np.array(answer["qpos"]), self.steps + 1
        self.is_solved, self.done = answer["terminated"], answer["truncated"]


@cache
def made_robot(kind: str, text: str, gap: float) -> RobotSpec:
    """KinDER's robot as ours, made of the text of its own MJCF file and kept in the user's cache. `gap` is in [m].

    Raises:
        InvalidRobot: the file is not that of this robot.
    """
    name = "franka" if kind == "fr3" else kind
    with tempfile.NamedTemporaryFile("w", suffix=".xml", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        made, page, _ = make_robot(Path(file.name), _ROBOTS[kind].mounting)
    made = _with_linkage(made, _ROBOTS[kind].mounting.tool)
    page |= {"name": name, "home": _ROBOTS[kind].home, "finger_geoms": FINGERS}
    spec = RobotSpec.from_mjcf(kept_mjcf(name, made), **page, grasp_height=0.03, finger_gap=gap)
    limits = [_SPEED] * 3 + [np.inf] + [_ROBOTS[kind].arm_speed] * (len(spec.chain) - 1)
    return replace(spec, max_velocity=tuple(np.minimum(spec.max_velocity, limits).tolist()))


def _with_linkage(mjcf: str, tool: float) -> str:
    """The same robot with fingers and linkage of KinDER's hand, whose pinch site is `tool` [m] behind the TCP."""
    spec = mujoco.MjSpec.from_string(mjcf)
    gripper, site = spec.body("gripper"), spec.site("grip")
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, site.quat)
    for name, side in zip(FINGERS, (1.0, -1.0), strict=True):
        pad, finger = spec.geom(name), spec.body(name)
        pad.size[1:] = _PAD
        pad.pos[1] = side * _PAD[0]
        to_finger = float((site.pos - finger.pos) @ rotation.reshape(3, 3)[:, 0]) - tool
        for body, (back, front, inner, outer), at, quat in (
            (finger, _KNUCKLE, np.array([to_finger, 0.0, 0.0]), (1.0, 0.0, 0.0, 0.0)),
            (gripper, _OUTSIDE, np.array([-tool, 0.0, 0.0]), site.quat),
        ):
            middle = at + [(back + front) / 2, side * (inner + outer) / 2, 0.0]
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=[(front - back) / 2, (outer - inner) / 2, _KNUCKLE_WIDTH],
                pos=middle if body is finger else site.pos + rotation.reshape(3, 3) @ middle,
                quat=quat,
                contype=2,
                conaffinity=0,
                mass=0,
            )
    spec.compile()
    return str(spec.to_xml())


def _finger_gap(xml: str, anchors: Collection[str]) -> float:
    """[m] between an object and each finger that is about to close on it, by what the objects of a task are."""
    for body in mujoco.MjSpec.from_string(xml).bodies:
        is_loose = any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in body.joints)
        has_mesh = any(geom.type == mujoco.mjtGeom.mjGEOM_MESH for geom in body.geoms)
        if is_loose and has_mesh and body.name not in anchors:
            return _WIDE_GAP
    return _FINGER_GAP


def _is_cube(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body is one box with equal sides on a free joint: it looks the same whichever side is up."""
    geoms = np.flatnonzero(model.geom_bodyid == body)
    is_free = model.jnt_type[model.body_jntadr[body]] == int(mujoco.mjtJoint.mjJNT_FREE)
    is_box = len(geoms) == 1 and model.geom_type[geoms[0]] == int(mujoco.mjtGeom.mjGEOM_BOX)
    return bool(is_free and is_box and np.ptp(model.geom_size[geoms[0]]) < _SAME)


def standing(quaternion: Array) -> Array:
    """The orientation (4,) of a cube, wxyz, with the side named upwards that is: it may have rolled when it fell."""
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, quaternion)
    R = flat.reshape(3, 3)
    up = int(np.abs(R[2]).argmax())
    columns = R[:, [(up + 1) % 3, (up + 2) % 3, up]]  # still right-handed
    if columns[2, 2] < 0:
        columns = columns * [1.0, -1.0, -1.0]
    turned = np.empty(4)
    mujoco.mju_mat2Quat(turned, np.ascontiguousarray(columns).ravel())
    return turned


def _region(scene: Scene, name: str, anchor: str, boxes: Array, facts: list[list[str]]) -> Region:
    """A region for our goals: KinDER's first box, grown as far as an object's centre stays within the box.

    KinDER compares the centre of an object with the box, our goals its whole footprint. An object may fall where the
    region's owner, its anchor, is below it.
    """
    low, high = boxes[0, :3], boxes[0, 3:]
    centre = (low[:2] + high[:2]) / 2
    shares = np.array(list(product((0.0, 0.25, 0.5, 0.75, 1.0), repeat=2)))
    points = low[:2] + shares * (high[:2] - low[:2])  # its middle may be beside what it belongs to, over the floor
    level = [
        one
        for one in scene.static_obstacles
        if one.has_level_top and low[2] - _BELOW < one.top < high[2] and one.is_under(points).any()
    ]
    support = max(level, key=lambda one: (one.is_under(centre), one.top)).name if level else "floor"
    is_inside = support.startswith(f"{anchor}/")  # let go in the middle, it comes to rest wherever the walls let it
    half = min(float(scene.body(fact[1]).half_extents.min()) for fact in facts if fact[2] == name)
    half_extents = (high[:2] - low[:2]) / 2 + half - (0.0 if is_inside else _MARGIN)
    return Region(name, support, tuple(centre), tuple(half_extents), drop=_DROP if is_inside else 0.0)
