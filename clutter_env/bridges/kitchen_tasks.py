"""The tasks of Gymnasium-Robotics' FrankaKitchen, solved through its action of nine joint velocities.

    task = KitchenTask("microwave", seed=0)
    expert = TampExpert(task.world, grasps=GRASPS)
    expert.reset()
    while not (expert.done or task.world.is_over):
        task.world.step(expert.act())
    print(expert.report, task.is_solved)

The environment adds a velocity to the joint positions that it observed last, with noise, and hands the sum to position
servos without integral part. So any set point near the arm can be asked for.
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
from assets.robot_reading import BASE_LIMITS, LIFT_LIMITS
from clutter_env.bridges.fetch_tasks import make
from clutter_env.bridges.kept import kept_mjcf
from clutter_env.bridges.remote import BridgeError
from planners import AntipodalFamily, ControlledWorld, Goal, goals, insert_robot

Array = NDArray[np.float64]

_ID, _ARM, _STAND = "FrankaKitchen-v1", "panda0_link0", "stand of the arm"
_JOINTS = 7
_HEIGHT, _BEHIND, _YAW = 1.8, 0.04, 1.57
"""[m] of the arm's base above the ground and in front of the middle of its pedestal. [rad] of its direction."""
_RADIUS = 0.08
"""[m] of the pedestal. The environment's pedestal stands in the handle of its oven."""
_OPENING = 0.08
"""[m] of the gripper."""
_TIP = 0.05
"""[m] from the site in the file to the ends of the fingers."""
_ROUND, _SHORT = 0.04, 0.025
"""[m] by which the fingers reach beyond the TCP. Handles are up to 64 mm thick, and slip off the ends otherwise. Knobs
are not that high."""
_MADE = 0.015
"""[m] by which pads reach beyond the TCP as they are made."""
_PAD = (0.035, 0.009, 0.016)
"""[m] Half extents of what stands for the capsules of a finger: along the approach, along its motion, across both."""
_BENT = 0.0
"""[rad] Least position to which the environment sends joint 6, whatever its range. Hand and forearm touch only from
-0.88 downwards."""
_FASTEST = (0.65,) * 4 + (1.0,) * 3
"""[rad/s] of the joints: their damping takes 65 of the 87 N m that the first four have, and 10 of 12 of the others'."""
_SPEED = 2.0
"""[rad/s], [m/s] that an action of 1 means."""
_LAG = np.array([100 / 870] * 4 + [10 / 120] * 3)
"""[s] by which the servos stay behind: damping by gain of the environment's files."""
_INTEGRAL = 0.4
"""Of what the arm lacks, by which its set point is moved further with each step."""
_MOST_OFF = 0.1
"""[rad] by which it is moved at most."""
_INSIDE = 0.01
"""[rad] from the limits, at home: the positions observed are noisy."""
_SAME = 1e-3
"""[m] by which a length may differ from that of a handle here: files give some by their ends."""
_SETTLE = 6
"""Steps in which the arm is brought back to its start: it sags when the environment begins."""
BARS = tuple(AntipodalFamily(f"bar, {pitch}°", np.radians(pitch), hangs=True) for pitch in (0, 30, 60, 90))
"""Grasps of handles and of the kettle's."""


@dataclass(frozen=True)
class _Part:
    """Part that a task moves: a body, half the length [m] of its handle, the goal, and how deep it is held."""

    body: str
    handle: float
    goal: Goal
    beyond: float = _ROUND


_TASKS = {
    "microwave": _Part("microdoorroot", 0.13, goals.open_("microdoorroot", amount=0.75)),
    "slide cabinet": _Part("slidelink", 0.159, goals.open_("slidelink", amount=0.37)),
    "hinge cabinet": _Part("hingerightdoor", 0.16, goals.open_("hingerightdoor", amount=1.3)),
    "light switch": _Part("lightswitchroot", 0.03, goals.open_("lightswitchroot", amount=0.5)),
    "bottom burner": _Part("knob 2", 0.048, goals.open_("knob 2", amount=0.88), _SHORT),
    "top burner": _Part("knob 4", 0.048, goals.open_("knob 4", amount=0.92), _SHORT),
    "kettle": _Part("kettle", 0.0, goals.at("kettle", (-0.23, 0.75))),
}


class KitchenTask:
    """One episode with one task: a `Controller`, and the world in which the expert plans.

    Attributes:
        world: for `TampExpert`, with the goal of the task.
        dt: [s] of one step.
        done: the episode is over: the task is completed, or 280 steps are taken.
        is_solved: whether the environment counts the task among those completed.
        steps: taken so far.
    """

    dt = 0.08

    def __init__(self, id: str, seed: int) -> None:
        """Reset the environment. Raises `BridgeError` if the task is none of those above."""
        if id not in _TASKS:
            raise BridgeError(f"no goal is known for {id!r}; there are {', '.join(_TASKS)}")
        self._id, self.steps, self.done, self.is_solved = id, 0, False, False
        self._env = make(_ID, tasks_to_complete=[id], disable_env_checker=True)
        observation, _ = self._env.reset(seed=seed)
        inner: Any = self._env.unwrapped
        file = Path(inner.robot_env.fullpath)
        part = _TASKS[id]
        self.robot = _panda(file, tuple(inner.data.qpos[:_JOINTS].tolist()), part.beyond)
        self._see(observation)
        model = insert_robot(_scene(file, part), self.robot, (0.0, -_BEHIND, 0.0, _YAW), without=[_STAND])
        joints = [inner.model.joint(number) for number in range(_JOINTS + 2, inner.model.njnt)]
        self._others = [(int(one.qposadr[0]), int(model.joint(one.name).qposadr[0]), len(one.qpos0)) for one in joints]
        self._columns = [int(model.joint(name).qposadr[0]) for name in self.robot.arm_joints]
        self._fingers = [int(model.joint(name).qposadr[0]) for name in FINGERS]
        self._lift = int(model.joint(self.robot.torso_joint).qposadr[0])
        self._qpos, self._offset = model.qpos0.copy(), np.zeros(_JOINTS)
        self._wanted = np.array(self.robot.home[1:])
        for _ in range(_SETTLE):
            self._step(self._wanted, _OPENING)
        self.world = ControlledWorld(
            self, model, self.robot, movable=["kettle"], support="stove", more_supports=(), goal=part.goal
        )

    @property
    def simulated(self) -> mujoco.MjData:
        """The environment's own state, without noise. No action here depends on it."""
        inner: Any = self._env.unwrapped
        data: mujoco.MjData = inner.data
        return data

    def observe(self) -> Array:
        """(nq,) positions as the environment's observation has them."""
        for theirs, ours, width in self._others:
            self._qpos[ours : ours + width] = self._state[theirs : theirs + width]
        self._qpos[self._columns] = self._state[:_JOINTS]
        self._qpos[self._fingers] = self.robot.finger_position(float(self._state[_JOINTS : _JOINTS + 2].sum()))
        return self._qpos

    def act(self, configuration: Array, opening: float) -> None:
        """One step of the environment."""
        self._step(configuration[4:], opening)

    def _step(self, q: Array, opening: float) -> None:
        """One step towards a configuration (7,): the set point is ahead of it by what the servos lack."""
        now = self._state[: _JOINTS + 2]
        self._offset = np.clip(self._offset + _INTEGRAL * (self._wanted - now[:_JOINTS]), -_MOST_OFF, _MOST_OFF)
        ahead, self._wanted = (q - self._wanted) * _LAG / self.dt, q
        aim = np.concatenate((q + ahead + self._offset, [opening / 2, opening / 2]))
        action = np.clip((aim - now) / (self.dt * _SPEED), -1.0, 1.0)
        observation, _, terminated, truncated, info = self._env.step(action)
        self._see(observation)
        self.steps += 1
        self.is_solved = self._id in info["episode_task_completions"]
        self.done = bool(terminated or truncated)

    def _see(self, observation: dict[str, Any]) -> None:
        robot, things = np.split(np.asarray(observation["observation"]), [2 * (_JOINTS + 2)])
        self._state = np.concatenate((robot[: _JOINTS + 2], things[:21]))


def _scene(file: Path, part: _Part) -> mujoco.MjSpec:
    """The kitchen with names for what has none: the arm's stand, the stove, and the handle of a task."""
    spec = mujoco.MjSpec.from_file(str(file))
    next(body for body in spec.worldbody.bodies if not body.name).name = _STAND
    top = max(
        (one for one in spec.body("ovenroot").geoms if one.contype or one.conaffinity), key=lambda one: one.size[2]
    )
    top.name = "stove"
    for geom in (one for one in spec.body(part.body).geoms if one.contype or one.conaffinity):
        if abs(geom.size[1] - part.handle) < _SAME:
            geom.name = "handle"
    return spec


@cache
def _panda(file: Path, start: tuple[float, ...], beyond: float) -> RobotSpec:
    """The environment's arm on a pedestal, with two pads in place of its fingers. Its home is as near to its start as
    the joints go, since the start is beyond a limit."""
    mounting = Mounting(
        _ARM,
        "end_effector",
        on=(_BEHIND, _HEIGHT),
        radius=_RADIUS,
        opening=_OPENING,
        tool=_TIP - beyond,
        apart=("panda0_link5", "panda0_link7"),
        drive="fixed",
    )
    mjcf, page, _ = make_robot(file, mounting)
    spec = mujoco.MjSpec.from_string(mjcf)
    for name, side in zip(FINGERS, (1.0, -1.0), strict=True):
        pad = spec.body(name).geoms[0]
        pad.size, pad.pos = _PAD, (beyond - _MADE, _PAD[1] * side, 0.0)
    wrist = spec.joint(f"robot:panda0_joint{_JOINTS - 1}")
    wrist.range = (_BENT, wrist.range[1])
    model = spec.compile()
    lower, upper = np.transpose([model.joint(f"robot:panda0_joint{number}").range for number in range(1, 1 + _JOINTS)])
    home = np.clip(start, lower + _INSIDE, upper - _INSIDE)
    page["max_velocity"] = (*BASE_LIMITS, LIFT_LIMITS[0], *_FASTEST)
    return RobotSpec.from_mjcf(kept_mjcf("panda-kitchen", spec.to_xml()), **page, name="panda", home=(0.0, *home))
