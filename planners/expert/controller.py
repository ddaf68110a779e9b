"""The expert in another simulator, or on a robot: it only needs joint positions and commands for the joints.

Example:
    world = ControlledWorld(MyController(env), model, FETCH, movable=["can", "box"], support="table")
    expert = TampExpert(world)
    expert.reset("can")
    while not (expert.done or world.is_over):
        world.step(expert.act())
    print(expert.report)
"""

from __future__ import annotations

import gc
from collections.abc import Collection, Iterable
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets.robots import RobotSpec
from planners.expert.config import ExpertError
from planners.goals import LIFTED, Goal, Region
from planners.motion.tcp_following import ON_THE_WAY
from planners.scene import Scene
from planners.scene.mujoco_reading import Movable, MovableBodies, is_object_name

Array = NDArray[np.float64]


class Controller(Protocol):
    """A controller that moves the robot, at its own rate and by its own method: targets, deltas or torques.

    The expert waits for a lagging robot, with the smallest tolerance where fingers close and open. So `act` may limit
    its motion.

    Attributes:
        dt: duration [s] of one `act`.
        done: whether the episode is over: the controller executes no more commands.
    """

    dt: float
    done: bool

    def observe(self) -> ArrayLike:
        """Present positions (nq,) of all joints of the model that the expert plans in."""
        ...

    def act(self, configuration: Array, opening: float) -> None:
        """Move towards a configuration for `dt`.

        Args:
            configuration: (4 + n,) base x, y [m], yaw [rad], torso [m], arm [rad]. Angles may be full turns away.
            opening: distance [m] of the finger pads.
        """
        ...


class ControlledWorld:
    """An environment for `TampExpert`, made of a `Controller` and a model of its world.

    Attributes:
        model: the world as the planner sees it: the simulator's model, or a copy of it.
        data: its last observed state.
        dt: duration [s] of one step.
        more_supports: other geoms or bodies on which objects may be put. None means those that the model declares.
        regions: named rectangles on supports, for goals.
        goal: the goal of the environment. None if `TampExpert.reset` gets the goal.
        line_tolerance: lag [m] allowed for the TCP on straight lines to and from an object.
    """

    goal: Goal | None = None
    control_mode = "joint"
    waits_for_tcp = True
    lift_height = LIFTED

    def __init__(
        self,
        controller: Controller,
        model: mujoco.MjModel,
        robot: RobotSpec,
        *,
        movable: Movable = is_object_name,
        support: str | None = None,
        more_supports: Collection[str] | None = None,
        regions: Iterable[Region] = (),
        goal: Goal | None = None,
        line_tolerance: float = ON_THE_WAY,
    ) -> None:
        """Observe the world.

        Args:
            controller: the controller of the robot.
            model: the model, with the robot under the names of `robot`. Nothing is simulated in it.
            movable, support, more_supports, regions: as for `Scene.from_mujoco`.
            goal, line_tolerance: as the attributes.

        Raises:
            ExpertError: the step is no positive time, or positions do not fit the model.
            SceneError: the model lacks the robot or an object.
        """
        if not (np.isfinite(controller.dt) and controller.dt > 0):
            kind = type(controller).__name__
            raise ExpertError(f"dt={controller.dt!r} of {kind} is not valid; it must be a time [s]")
        # Earlier worlds are in cycles with their controllers. Python's collector does not count MuJoCo's memory, and
        # would keep them for dozens of episodes.
        gc.collect()
        self.model, self.data, self.robot = model, mujoco.MjData(model), robot
        self.object_names = MovableBodies.of(model, robot, movable).names
        self.more_supports, self.regions, self.goal = more_supports, tuple(regions), goal
        self.dt, self._controller, self.line_tolerance = float(controller.dt), controller, line_tolerance
        self._observe()
        if support is None:
            support = Scene.from_mujoco(model, self.data, robot, movable=movable, more_supports=()).supports[0]
        self.support_name = support

    @property
    def is_over(self) -> bool:
        """Whether the controller executes no more commands."""
        return bool(self._controller.done)

    def joint_action(self, q_target: Array, gripper_width: float | Array) -> Array:
        """Configuration and gripper opening (5 + n,) for `step`."""
        return np.append(q_target, gripper_width)

    def step(self, action: Array) -> None:
        """Let the controller execute an action of the expert, and observe."""
        if not self.is_over:
            self._controller.act(action[:-1], float(action[-1]))
        self.data.time += self.dt
        self._observe()

    def _observe(self) -> None:
        positions = np.asarray(self._controller.observe(), dtype=float)
        if positions.shape != (self.model.nq,) or not np.isfinite(positions).all():
            raise ExpertError(f"observe() must return {self.model.nq} finite numbers, qpos of the model")
        self.data.qpos[:] = positions
        mujoco.mj_forward(self.model, self.data)
