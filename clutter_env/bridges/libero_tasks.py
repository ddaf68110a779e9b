"""LIBERO's tasks, LIBERO-PRO's variants and any BDDL file of theirs, solved through LIBERO's own `step`.

with Remote("venv-libero/bin/python", "libero_worker.py") as libero:
    task = LiberoTask(libero, "libero_goal", 3, state=0)
    expert = TampExpert(task.world, planner=task.planner, config=task.config)
    expert.reset()
    while not (expert.done or task.world.is_over):
        task.world.step(expert.act())
    print(expert.report, task.is_solved)

The action is LIBERO's: seven numbers, of the operational-space controller of `clutter_env.bridges.osc_task`.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import assets
from assets import RobotSpec
from clutter_env.bridges.kept import kept_mjcf
from clutter_env.bridges.libero_goals import wanted_in
from clutter_env.bridges.osc_task import BESIDE, OscTask
from clutter_env.bridges.remote import Remote
from planners import ControlledWorld, ExpertConfig, FollowingPlanner, MonitorConfig
from planners.grasping.families import GRASP_SETS, TOP, AntipodalFamily

SETTLE = 10
"""Steps in which objects come to rest, as in LIBERO's evaluations; they are not counted."""
LONGEST_WAIT = 60
"""Steps that are waited at most for objects that are still falling or toppling then; they are counted."""
LIMITS = {"libero_spatial": 220, "libero_object": 280, "libero_goal": 300, "libero_10": 520, "libero_90": 400}
"""Steps after which evaluations of policies end an episode, by suite."""
_FINGER_STEPS, _CLOSING_STEPS = 8, 14
"""Of the environment in which its gripper is told to open or close all the way, and in which it does: fingers that have
not yet closed on the wall of a bowl lose it when they rise."""
_ARM = (0.17, 0.5)
"""[m] x, z of our Panda's arm on its base, with the lift down."""
_SHORTER = 0.0067
"""[m] by which the fingers of robosuite's hand reach less far than ours: to 2.3 mm beyond the TCP."""
_ABOUT = 0.03
"""[m] about a region of a drawer in which an object counts as in it."""
_SLIP = 0.05
"""[m] that what is held may move in the gripper, as it does where its wall turns until it lies between the pads."""
_MANY, _ROUND, _NEAR_END, _FILLED = 8, 0.8, 0.2, 0.85
"""Boxes from which on a body may be a cylinder; share of a circle that its ends cover at least; share of its half
length within which points are at an end; and share of its length that a box in its middle has."""
_INSET = 0.012
"""[m] below the rim of a bowl at least. The gripper comes to within 6 mm of where it closes, and its tips reach 2.3 mm
beyond the TCP: 6 mm below the rim they missed the bowl on the stove twice, and the hand left without it."""
_GRASPS = (
    *(replace(one, inset=_INSET) if isinstance(one, AntipodalFamily) else one for one in GRASP_SETS["all"]),
    *(replace(TOP, name=f"top, {1000 * x:+.0f} mm off the middle", axis_offset=x, shape="box") for x in (0.02, -0.02)),
)
"""Boxes lie beside cans that the palm would touch."""
_ON_ITS_HEAD = 0.99
"""Cosine of the tilt up to which an object stands on its head."""
_SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
_CLEAR = 0.03
"""[m] between what the arm is bolted to and its lowest shapes: in LIBERO they touch, which is no collision."""
_SPEEDS, _ACCELERATIONS = (2.175,) * 4 + (2.61,) * 3, (6.0,) * 4 + (7.5,) * 3
"""[rad/s] of a Panda's joints by its data sheet, and [rad/s²]; where OSC_POSE keeps the gripper behind, plans wait."""
_LIFT = (-0.5, 0.6)
"""[m] The arm stands between the floor and 1.1 m."""


class LiberoTask(OscTask):
    """One episode of a task of LIBERO: a `Controller`, and the world to plan in.

    Attributes:
        world: for `TampExpert`; its goal is that of the task.
        planner: for `TampExpert`: its plans are such that the arm can follow them.
        config: for `TampExpert`: a bowl held by its slanting wall tilts in the fingers, and is held all the same.
        language: what LIBERO tells a policy.
        limit: steps after which evaluations end, or None where there is no such custom.
        solved_at: steps after which LIBERO's check held first; None before.
        actions: taken so far: seven numbers each.
    """

    def __init__(
        self,
        libero: Remote,
        suite: str = "",
        task: int = 0,
        state: int = 0,
        *,
        bddl: str | Path = "",
    ) -> None:
        """Reset the environment.

        Args:
            libero: the worker.
            suite: name of one of LIBERO's suites or LIBERO-PRO's variants of them.
            task: number of the task in the suite.
            state: number of its frozen initial state; with `bddl`, the seed of the placement.
            bddl: a BDDL file, in place of suite and task.

        Raises:
            BridgeError: there is no such suite, task, state or file, or it asks for what no goal can say here.
        """
        if bddl:
            start = libero("reset_file", bddl=str(bddl), seed=state, settle=SETTLE)
        else:
            start = libero("reset", suite=suite, task=task, state=state, settle=SETTLE)
        x, y, z = start["base"]
        place = np.array([x - _ARM[0], y, 0.0]), z - _ARM[1]
        super().__init__(libero, start, _spec_of(start), _panda(), place, _FINGER_STEPS, _CLOSING_STEPS)
        self.solved_at: int | None = None
        self.actions: list[list[float]] = []
        self._wait()
        self.language: str = start["language"]
        known = [name for name in LIMITS if suite.startswith(name)]
        self.limit = LIMITS[known[0]] if known else None
        self.config = ExpertConfig(planning_s=math.inf, with_floor=False, monitor=MonitorConfig(slip=_SLIP))
        follower = self.follower(start, "Panda")
        self.planner = FollowingPlanner(self.robot, grasps=_GRASPS, controller=follower, saves_time=True)
        model = self.model
        free = [model.joint(int(k)) for k in np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))]
        movable = [model.body(int(joint.bodyid[0])).name for joint in free]
        self.world = ControlledWorld(self, model, self.robot, movable=movable, line_tolerance=BESIDE)
        wanted = wanted_in(start, self.world)
        self.world.goal, self.world.regions, self.world.more_supports = wanted.goal, wanted.regions, wanted.supports

    def _wait(self) -> None:
        """Let objects come to rest: some frozen states begin with objects more than a metre up."""
        while self._is_moving and self.steps < LONGEST_WAIT:
            self._step(np.zeros(6), -1.0)
        self._begin()

    def _read(self, answer: dict[str, Any]) -> None:
        super()._read(answer)
        self._is_moving: bool = answer["is_moving"]

    def _step(self, action: np.ndarray, grip: float) -> None:
        super()._step(action, grip)
        self.actions.append([*map(float, action), grip])
        if self.is_solved and self.solved_at is None:
            self.solved_at = self.steps


def _spec_of(start: dict[str, Any]) -> mujoco.MjSpec:
    """LIBERO's model, in which drawers, doors and knobs without a part in the goal stay as they are.

    Cans, which it makes of thirty boxes, are cylinders: grasps of many pieces take long to find.
    """
    spec = mujoco.MjSpec.from_string(start["xml"])
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = start["qpos"]
    mujoco.mj_kinematics(model, data)
    sites, needed = start["sites"], set[str]()
    moved = [data.body(start["roots"][fact[1]]).xpos for fact in start["goal"] if fact[1] in start["roots"]]
    for name, site in sites.items():
        there = data.site(name)
        away = [np.abs(there.xmat.reshape(3, 3).T @ (one - there.xpos)) for one in moved]
        if any((one < np.array(site["size"]) + _ABOUT).all() for one in away):
            needed.update(site["joints"])
    for name in (name for fact in start["goal"] for name in fact[1:]):
        needed.update(sites[name]["joints"] if name in sites else start["object_joints"].get(name, ()))
    for body in (one for one in spec.bodies if any(j.type == mujoco.mjtJoint.mjJNT_FREE for j in one.joints)):
        _make_round(spec, body)
        _make_upright(body, data.body(body.name).xmat.reshape(3, 3))
    for joint in spec.joints:
        if joint.type != mujoco.mjtJoint.mjJNT_FREE and joint.name not in needed:
            joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE  # without a range nothing counts as opening
    return spec


def _make_round(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    """Make a body of many boxes that is filled and round about one of its axes a cylinder."""
    boxes = [one for one in body.geoms if one.contype or one.conaffinity]
    if len(boxes) < _MANY or any(one.type != mujoco.mjtGeom.mjGEOM_BOX for one in boxes):
        return
    frames = [Rotation.from_quat(one.quat, scalar_first=True).as_matrix() for one in boxes]
    corners = [one.pos + (_SIGNS * one.size) @ frame.T for one, frame in zip(boxes, frames, strict=True)]
    points = np.concatenate(corners)
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    for axis in range(3):
        across = [k for k in range(3) if k != axis]
        radius = float(np.linalg.norm((points - middle)[:, across], axis=1).max())
        ends = [
            points[np.abs(points[:, axis] - end) < _NEAR_END * half[axis]][:, across] for end in (low[axis], high[axis])
        ]
        areas = [ConvexHull(one).volume / (math.pi * radius**2) if len(one) > 2 else 0.0 for one in ends]
        spans = [(one.min(axis=0) - middle, one.max(axis=0) - middle) for one in corners]
        inside = [
            (least < 0.0)[across].all()
            and (most > 0.0)[across].all()
            and (most - least)[axis] > 2 * _FILLED * half[axis]
            for least, most in spans
        ]
        if min(areas) > _ROUND and any(inside):
            for one in boxes:
                spec.delete(one)
            turn = Rotation.align_vectors(np.eye(3)[axis], (0.0, 0.0, 1.0))[0].as_quat(scalar_first=True)
            size = (radius * math.sqrt(min(areas)), float(half[axis]), 0.0)
            body.add_geom(
                name=f"{body.name}_round",
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                pos=middle,
                quat=turn,
                size=size,
                mass=0.05,
            )
            return


def _make_upright(body: mujoco.MjsBody, rotation: np.ndarray) -> None:
    """Turn the axes of a single box or cylinder over that stands on its head in its frozen state.

    The planner would take it for fallen: such an object is put down at any angle about the vertical, and fits into no
    narrow place. What lies on a side may well be put down on another one, and stays as it is.
    """
    solids = [one for one in body.geoms if one.contype or one.conaffinity]
    if len(solids) != 1 or solids[0].type not in (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER):
        return
    own = Rotation.from_quat(solids[0].quat, scalar_first=True)
    if rotation[2] @ own.as_matrix()[:, 2] < -_ON_ITS_HEAD:
        solids[0].quat = (own * Rotation.from_rotvec((math.pi, 0.0, 0.0))).as_quat(scalar_first=True)


@cache
def _panda() -> RobotSpec:
    """Our Panda bolted down at any height, without base and mast, with the fingers of robosuite's hand."""
    robot = assets.robot("panda_mobile").fixed()
    spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
    for name in ("base", "column", "mast", "lift"):
        spec.delete(spec.geom(name))
    foot, column, first = (spec.geom(name) for name in ("foot", "shoulder_column", "link1"))
    foot.size[0] -= _CLEAR
    column.size[1] -= _CLEAR / 2
    column.pos[2] += _CLEAR / 2
    first.fromto[2] += float(first.size[0]) + _CLEAR
    for name in robot.finger_joints:
        spec.joint(name).parent.pos[2] -= _SHORTER
    spec.joint(robot.torso_joint).range = _LIFT
    spec.compile()
    lift = robot.chain[0]._replace(lower=_LIFT[0], upper=_LIFT[1])
    return replace(
        robot,
        mjcf=str(kept_mjcf("panda-libero", spec.to_xml())),
        chain=(lift, *robot.chain[1:]),
        max_velocity=(*robot.max_velocity[:4], *_SPEEDS),
        max_acceleration=(*robot.max_acceleration[:4], *_ACCELERATIONS),
    )
