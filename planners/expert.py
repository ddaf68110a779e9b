"""The scripted expert: plans, executes in physics, watches, and replans when the world is not as expected."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from irm.kinematics import ArmChain
from planners.arm_motion import tcp_pose
from planners.clearance_floor import ClearanceFloor
from planners.execution import Execution, Outcome
from planners.monitor import MonitorConfig, Sensor
from planners.scene import RobotState, Scene
from planners.solution import Infeasible, Solution
from planners.solve import Planner
from planners.strategies import strategy as find_strategy

__all__ = ["EpisodeReport", "ExpertConfig", "TampExpert"]

Array = NDArray[np.float64]

CONTROL_STEP = 0.05
"""[s] of one action."""


class ControlledEnv(Protocol):
    """What the expert needs of an environment (`env.unwrapped`)."""

    model: mujoco.MjModel
    data: mujoco.MjData
    robot: RobotSpec

    def joint_action(self, q_target: Array, gripper_width: float) -> Array: ...

    def ee_action(self, base_target: Array, T_world_tcp: Array, gripper_width: float) -> Array: ...


@dataclass(frozen=True)
class ExpertConfig:
    """How the expert goes about it.

    Attributes:
        replans: new plans at most after surprises in one episode.
        planning_s: [s] for one solve.
        settle_s: [s] to wait before looking at the scene again after a surprise.
        hold_s: [s] to hold the target up in the end.
        with_floor: whether the report says how many clearances were needed at least.
        monitor: what counts as a surprise.
    """

    replans: int = 6
    planning_s: float = 30.0
    settle_s: float = 0.5
    hold_s: float = 0.8
    with_floor: bool = True
    monitor: MonitorConfig = field(default_factory=MonitorConfig)


@dataclass(frozen=True)
class EpisodeReport:
    """How an episode went.

    Attributes:
        planned: a plan was found (the last one, if there were several).
        executed: the last plan was carried out to its end.
        scored: the target is held up.
        failure: why not, "" for success.
        clearances: objects put aside in physics, in order.
        duplicated: those put aside more than once.
        replans: plans made after the first one.
        floor: the fewest objects any plan must clear, None if not asked for or not proved.
        planning_s: CPU time [s] spent planning.
        sim_s: simulated time [s] since reset.
        surprises: what made the expert replan, in words.
    """

    planned: bool = False
    executed: bool = False
    scored: bool = False
    failure: str = ""
    clearances: tuple[str, ...] = ()
    duplicated: tuple[str, ...] = ()
    replans: int = 0
    floor: int | None = None
    planning_s: float = 0.0
    sim_s: float = 0.0
    surprises: tuple[str, ...] = ()


class TampExpert:
    """A policy for `clutter_env/Retrieve-…` that plans with exact knowledge of all object poses (privileged).

    Example:
        env = gymnasium.make("clutter_env/Retrieve-o15-v0")
        _, info = env.reset(seed=0)
        expert = TampExpert(env)
        expert.reset(info["target"])
        while not expert.done:
            env.step(expert.act())
        print(expert.report)
    """

    def __init__(
        self, env: Any, strategy: str = "lookahead", *, seed: int = 0, config: ExpertConfig | None = None
    ) -> None:
        """Make an expert for an environment.

        Args:
            env: a Gymnasium environment of this package, wrapped or not.
            strategy: how to clear; see `planners.strategies`.
            seed: of the planner's sampling.
            config: limits and tolerances.

        Raises:
            UnknownStrategy: no strategy of that name.
        """
        find_strategy(strategy)
        self._env: Any = env.unwrapped
        self._strategy = strategy
        self._seed = seed
        self._config = config or ExpertConfig()
        self._planner = Planner(self._env.robot)
        self.report = EpisodeReport()
        self.done = True
        self.solution: Solution | Infeasible | None = None

    def reset(self, target: str | None = None) -> None:
        """Look at the scene and plan, from any state of the environment.

        Args:
            target: the object to retrieve; the environment's own target if not given.
        """
        self._sensor = Sensor(self._env.model, self._env.data, self._env.robot)
        self._target = target or self._env.world.names[self._env.target_slot]
        self._rng = np.random.default_rng(self._seed)
        self._started = float(self._env.data.time)
        self._chain = ArmChain.from_robot(self._env.robot)
        self.report = EpisodeReport()
        self.done = False
        self._wait = 0
        self._plan(self._look())

    @property
    def phase(self) -> str:
        """What the robot is doing, for example "PickUp object_03: lift"; "" while it waits."""
        return "" if self._execution is None else self._execution.phase

    def act(self) -> Array:
        """The next action; call it once per step, and step with it."""
        if self._wait > 0:
            self._wait -= 1
            if self._wait == 0:
                self._look_again()
            return self._command(self._here())
        if self._execution is None:
            self.done = True
            return self._command(self._here())
        step = self._execution.advance(self._sensor.read())
        if step.outcome is not Outcome.RUNNING:
            self._conclude(step.outcome)
        return self._command(step.command)
