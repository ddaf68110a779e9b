"""MetaWorld's drawers, doors, window and faucet, opened and shut through their action of four numbers.

with Remote("venv-metaworld/bin/python", "metaworld_worker.py") as metaworld:
    task = MetaworldTask(metaworld, "drawer-open", seed=0)
    expert = TampExpert(task.world, grasps=DOWN)
    expert.reset()
    while not (expert.done or task.world.is_over):
        task.world.step(expert.act())
    print(expert.report, task.is_solved)  # "success" of some step, as MetaWorld's evaluation counts

The action moves the Sawyer's hand, which always points down with its fingers along y: the action does not decide how
the arm follows. Only hand and fingers can touch anything. So only the positions of the TCP are played.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from assets.robot_making import FINGERS, Mounting, make_robot
from clutter_env.bridges.kept import kept_mjcf
from clutter_env.bridges.remote import BridgeError, Remote
from planners import AntipodalFamily, ControlledWorld, Goal, RobotState, goals, insert_robot, tcp_pose

Array = NDArray[np.float64]

_ARM = tuple(f"right_j{number}" for number in range(7))
_GROUND = 0.913
"""[m] from the ground up to the arm's base, which is at z = 0."""
_ORIGIN = np.array([0.0, 0.0, _GROUND])
"""[m] of MetaWorld's origin here, where the ground is at z = 0."""
_PAD = (0.045, 0.006, 0.015)
"""[m] Half extents of a finger, its pad among it: downwards, along its motion, across both."""
_GAP, _TRAVEL = 0.018, 0.035
"""[m] between the pads where the fingers are closed, and that each of them opens."""
_OPEN = _GAP + 2 * _TRAVEL
_BEYOND = 0.01
"""[m] or [rad] that the joints are longer here than in MetaWorld's files: a drawer counts as open at its very stop."""
_FREE = {"right_j1": (-3.8, 2.2)}
"""[rad] Ranges of joints that MetaWorld's files narrow, as of the arm's data sheet."""
_TINY = 0.01
"""[m] Radius of what stands for a link of the arm: nothing touches these in MetaWorld."""
_LEAD = 4.0
"""By how much of what the hand lacks its set point is ahead of where it should be: it hangs on a soft weld."""
_SERVO = 8.0
"""By how much the fingers' set point is ahead of where they should be, in what they lack: they are slow."""
_GENTLE = 0.1
"""The same where they hold something, for 40 N: a handle must be able to turn in a hand that does not."""
_NEAR, _PRECISE = 0.01, 0.004
"""[m] that the hand may be off its place on the way, and where it touches something."""
_STILL = 0.0005
"""[m] that a finger moves in a step, or the opening wanted changes, that counts as standing."""
_MOST, _PATIENT = 12, 3
"""Largest number of steps for one command, and steps to wait for a hand that comes no nearer."""
DOWN = (AntipodalFamily("down", np.pi / 2, directions=2, hangs=True),)
"""The hand's one orientation."""


@dataclass(frozen=True)
class _Part:
    """The moving part of a task: its body, its handles by the radius [m] of the geoms, and the goal."""

    body: str
    handles: tuple[float, ...]
    goal: Goal


_TASKS = {
    "drawer-open": _Part("drawer_link", (0.009,), goals.open_("drawer_link", share=1.0)),
    "drawer-close": _Part("drawer_link", (0.009,), goals.closed("drawer_link")),
    "door-open": _Part("door_link", (0.019, 0.023), goals.open_("door_link", amount=1.6)),
    "door-close": _Part("door_link", (0.019, 0.023), goals.closed("door_link")),
    "window-open": _Part("windowb_a", (0.008,), goals.open_("windowb_a", share=1.0)),
    "faucet-open": _Part("faucet_link2", (0.017,), goals.open_("faucet_link2", share=1.0)),
}


class MetaworldTask:
    """One episode: a `Controller`, and the world in which the expert plans.

    Attributes:
        world: for `TampExpert`, with the goal of the task.
        dt: [s] of the plan in one `act`, which is as many steps as the hand needs.
        done: the episode is over: solved, or 500 steps are taken.
        is_solved: result of the environment's own check. MetaWorld's evaluation ends an episode at that.
        steps: taken so far, of 500.
    """

    dt = 0.05

    def __init__(self, metaworld: Remote, id: str, seed: int) -> None:
        """Reset the environment. Raises `BridgeError` if the task is none of those above."""
        if id not in _TASKS:
            raise BridgeError(f"no goal is known for {id!r}; there are {', '.join(_TASKS)}")
        self._metaworld, self.steps = metaworld, 0
        start = metaworld("reset", id=f"{id}-v3", seed=seed)
        joints = start["joints"]
        home = (0.0, *(start["qpos"][joints[name]] for name in _ARM))
        self.robot = _sawyer(start["file"], home)
        part = _TASKS[id]
        model = insert_robot(_scene(start, part), self.robot, (0.0, 0.0, -_GROUND, 0.0), without=["base", "mocap"])
        moving = model.body(part.body).jntadr[0]
        self._part = joints[model.joint(moving).name], int(model.jnt_qposadr[moving])
        self._columns = [int(model.joint(name).qposadr[0]) for name in self.robot.drive_joints[3:]]
        self._fingers = [int(model.joint(name).qposadr[0]) for name in FINGERS]
        self._lowest, self._highest = np.array(start["lowest"]), np.array(start["highest"])
        self._speed = start["speed"]
        self._qpos, self._q, self._opening = model.qpos0.copy(), np.array(home), _OPEN
        self._read(start)
        self._target = self._hand
        self.world = ControlledWorld(self, model, self.robot, movable=(), support="tablelink", goal=part.goal)

    def _read(self, answer: dict[str, Any]) -> None:
        self._state, self._hand = np.array(answer["qpos"]), np.array(answer["hand"])
        self._commanded, (right, left) = np.array(answer["commanded"]), answer["fingers"]
        self._gap = left - right - _PAD[1]
        self._hand[1] = (left + right) / 2  # closed fingers are not in the middle of the hand
        self.is_solved = answer["is_success"]
        self.done = self.is_solved or answer["done"]

    def observe(self) -> Array:
        """(nq,) what opens where it is, the arm where it was commanded."""
        theirs, ours = self._part
        self._qpos[ours] = self._state[theirs]
        self._qpos[self._columns] = self._q
        self._qpos[self._fingers] = self.robot.finger_position(self._gap)
        return self._qpos

    def act(self, configuration: Array, opening: float) -> None:
        """Steps of the environment until the hand is where it should be."""
        T = tcp_pose(self.robot, RobotState(configuration[:3], configuration[3:], 0.0))
        target = np.clip(T[:3, 3] - _ORIGIN, self._lowest, self._highest)
        stays = float(np.linalg.norm(target - self._target)) < _STILL
        changes = abs(opening - self._opening) > _STILL
        self._q, self._target, self._opening = configuration[3:], target, opening
        for count in range(_MOST):
            gap, lacked = self._gap, float(np.linalg.norm(self._lacks))
            self._step()
            lacks = float(np.linalg.norm(self._lacks))
            is_stuck = count >= _PATIENT and lacked - lacks < _STILL
            is_wide = abs(self._gap - opening) < _NEAR / 2 or abs(self._gap - gap) < _STILL
            is_near = lacks < (_PRECISE if stays else _NEAR) or is_stuck
            if self.done or (is_near and (is_wide or not changes)):
                break

    @property
    def _lacks(self) -> Array:
        """(3,) [m] of the hand to its target. 0 along axes on which its set point can go no farther."""
        is_free = (self._target > self._lowest) & (self._target < self._highest)
        return np.where(is_free, self._target - self._hand, 0.0)

    def _step(self) -> None:
        """One step, with the set point ahead of the target by what the hand lacks."""
        wanted = np.clip(self._target + _LEAD * self._lacks, self._lowest, self._highest)
        action = np.clip((wanted - self._commanded) / self._speed, -1.0, 1.0)
        narrower = _SERVO * (self._gap - self._opening) / 2
        if self._opening < _GAP + _STILL:
            narrower = min(narrower, _GENTLE)
        grip = float(np.clip((_OPEN - self._gap) / 2 + narrower, -1.0, 1.0))
        self._read(self._metaworld("step", action=[*action.tolist(), grip]))
        self.steps += 1


def _scene(start: dict[str, Any], part: _Part) -> mujoco.MjSpec:
    """The scene of an episode: bodies where they stand, the joint a little longer, handles named."""
    spec = mujoco.MjSpec.from_file(start["file"])
    for name, position in start["bodies"].items():
        spec.body(name).pos = position
    body = spec.body(part.body)
    for joint in body.joints:
        low, high = joint.range
        joint.range = (low - _BEYOND * (low < 0), high + _BEYOND * (high > 0))
    for number, geom in enumerate(body.geoms):
        if geom.contype and any(abs(geom.size[0] - radius) < 1e-6 for radius in part.handles):
            geom.name = f"handle {number}"
    return spec


def _sawyer(file: str, home: tuple[float, ...]) -> RobotSpec:
    """MetaWorld's arm out of one of its files, standing still, with its hand and the fingers of its own."""
    mjcf, page = _kept_sawyer(file)
    return RobotSpec.from_mjcf(mjcf, **page, name="sawyer", home=home)


@cache
def _kept_sawyer(file: str) -> tuple[Path, dict[str, Any]]:
    """The MJCF file of the robot, kept, and its page."""
    mounting = Mounting(
        "right_arm_base_link",
        "hand",
        approach="x",
        on=(0.0, _GROUND),
        radius=0.15,
        opening=_OPEN,
        lift=(-0.3, 0.5),
        without=("head",),
        drive="fixed",
    )
    mjcf, page, _ = make_robot(Path(file), mounting)
    spec = mujoco.MjSpec.from_string(mjcf)
    for name, side in zip(FINGERS, (1.0, -1.0), strict=True):
        finger = spec.body(name)
        finger.pos = spec.body("gripper").sites[0].pos
        finger.joints[0].range = (0.0, _TRAVEL)
        finger.geoms[0].size, finger.geoms[0].pos = _PAD, (0.0, (_GAP / 2 + _PAD[1]) * side, 0.0)
    spec.delete(spec.geom("palm"))
    for body in spec.bodies:
        if body.name.startswith("right_l"):
            for joint in body.joints:
                joint.range = _FREE.get(joint.name, joint.range)
            for geom in body.geoms:
                geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, (_TINY, 0.0, 0.0)
    spec.compile()
    return kept_mjcf("sawyer-metaworld", spec.to_xml()), page
