"""`Reach` and `Pick`: goal environments for hindsight relabelling."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from clutter_env.config import EnvConfig
from clutter_env.envs.base import BaseEnv
from clutter_env.envs.reset_options import ResetOptions
from clutter_env.errors import check_choice, check_integer
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.saved_state import Fields

if TYPE_CHECKING:
    from planners.goals import Goal

GOAL_TOLERANCE = 0.05
"""Distance [m] within which the goal is reached."""
_STANDING = 0.02
"""Height [m] above a standing object up to which a goal is a place on the table."""
_PLACE_TOLERANCE = 0.04
"""Horizontal tolerance [m] of such a place. With an error in height of `_STANDING` it is within `GOAL_TOLERANCE`."""
GOAL_BOUND = 16.0
"""Bound [m] of goals in the world frame, far outside the ground that the base may use."""

REACH_LOW, REACH_HIGH = (0.50, -0.40, 0.85), (0.95, 0.40, 1.30)
"""Box [m] of the Reach goals in the frame of the base at the start: within the arm's reach, above the table."""

PICK_X = (-0.25, 0.05)
"""Range [m] of x of the object to pick, from the table's centre. The rest of the table is beyond the arm's reach."""
PICK_DISTANCE = (0.70, 0.85)
"""Range [m] of its distance ahead of the base."""
PICK_SIDE = 0.15
"""Largest distance [m] to the side of the base."""
PICK_YAW = 0.2
"""Largest yaw [rad] of the base."""
GOAL_OFFSET = 0.15
"""Largest distance [m] of a Pick goal from the object's start, along x and along y."""
GOAL_LIFT = 0.25
"""Largest height [m] of a Pick goal above the object's start. Half of the goals are on the table."""


class GoalEnv(BaseEnv):
    """Observations are `observation`, `achieved_goal` and `desired_goal`. Goals are points in the world frame.

    Rewards, by `reward_mode`: "sparse", 0 within `GOAL_TOLERANCE` of the goal, else -1. "dense", minus the distance.
    `info["is_success"]` says that the goal is reached, whatever else has moved, as in relabelled rewards. The other
    keys of the info are those of `RetrieveEnv`. Episodes end only by their time limit.

    Raises:
        ConfigError: `success`, `terminate_on_fallen` or `reality` is given. They belong to the retrieval task.
    """

    _shows_goal = False

    def __init__(self, config: EnvConfig) -> None:
        for name in ("success", "terminate_on_fallen", "reality"):
            check_choice(name, getattr(config, name), (getattr(EnvConfig, name),))
        self._goal = np.zeros(3)
        super().__init__(config)

    @property
    def goal(self) -> NDArray[np.float64]:
        """A copy of this episode's goal (3,) in the world frame [m]."""
        return self._goal.copy()

    @abstractmethod
    def _achieved(self) -> NDArray[np.float64]:
        """The point (3,) that should come to the goal."""

    @abstractmethod
    def _draw_goal(self) -> NDArray[np.float64]:
        """A goal (3,) for the present first state."""

    def compute_reward(self, achieved_goal: NDArray[Any], desired_goal: NDArray[Any], info: Any) -> Any:  # noqa: ARG002
        """Rewards (...,) of achieved and desired goals (..., 3), bit for bit those of `step`."""
        distance = distances(np.asarray(achieved_goal, np.float64), np.asarray(desired_goal, np.float64))
        if self.config.reward_mode == "dense":
            return -distance
        return -(distance > GOAL_TOLERANCE).astype(np.float64)

    def _begin(self) -> None:
        self._goal = self._draw_goal()

    def _advance(self) -> tuple[float, bool]:
        return float(self.compute_reward(self._achieved(), self._goal, {})), False

    def _observe(self) -> dict[str, Any]:
        parts = self.observe_world(self.target_slot, 0.0, 0.0)
        vector = np.concatenate([parts.pop(name) for name in self._observer.names])
        return {
            "observation": vector,
            "achieved_goal": self._achieved().copy(),
            "desired_goal": self.goal,
            **parts,
        }

    def _make_observation_space(self) -> spaces.Dict:
        bounds = self._observer.bounds
        goal = spaces.Box(-GOAL_BOUND, GOAL_BOUND, (3,), np.float64)
        parts = super()._make_observation_space()
        return spaces.Dict(
            {
                "observation": spaces.Box(-bounds, bounds, dtype=np.float32),
                "achieved_goal": goal,
                "desired_goal": goal,
                **{name: space for name, space in parts.items() if name not in self._observer.names},
            }
        )

    def _is_success(self) -> bool:
        return bool(distances(self._achieved(), self._goal) <= GOAL_TOLERANCE)

    def _memory(self) -> dict[str, Any]:
        return {"goal": self._goal.tolist()}

    def _read_memory(self, memory: Any, scene: TableScene) -> NDArray[np.float64]:  # noqa: ARG002  as of other tasks
        return Fields(memory, "memory task", ("goal",)).numbers("goal", (3,), -GOAL_BOUND, GOAL_BOUND)

    def _recall(self, bookkeeping: NDArray[np.float64]) -> None:
        self._goal = bookkeeping


class GoalInterface(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """The outermost wrapper of `Reach` and `Pick`, which has their `compute_reward`. Put it around wrappers of your
    own.

    Stable-Baselines3's `check_env` calls `env.compute_reward(...)`, and since Gymnasium 1.0 a wrapper has only the
    attributes of its own class.

    Example:
        env = GoalInterface(gym.wrappers.TimeLimit(env, max_episode_steps=50))
    """

    def __init__(self, env: gym.Env) -> None:
        RecordConstructorArgs.__init__(self)
        super().__init__(env)

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Rewards (...,) of achieved and desired goals (..., 3), see `GoalEnv.compute_reward`."""
        return self.env.get_wrapper_attr("compute_reward")(achieved_goal, desired_goal, info)


class ReachEnv(GoalEnv):
    """Bring the TCP to a point in front of the robot. `num_objects` (0 by default) objects stand on the table."""

    def __init__(self, **keywords: Any) -> None:
        super().__init__(EnvConfig.from_keywords({"num_objects": 0, "control_mode": "ee", **keywords}))

    def _achieved(self) -> NDArray[np.float64]:
        return clipped(self.data.site_xpos[self.world.index.tcp_site])

    def _draw_goal(self) -> NDArray[np.float64]:
        x, y, yaw = self.world.scene.base
        ahead, left, up = self.np_random.uniform(REACH_LOW, REACH_HIGH)
        cosine, sine = math.cos(yaw), math.sin(yaw)
        return np.array([x + cosine * ahead - sine * left, y + sine * ahead + cosine * left, up])


class PickEnv(GoalEnv):
    """Bring the target object to a point above the table or on it. The base starts close to it."""

    def __init__(self, **keywords: Any) -> None:
        check_integer("num_objects", keywords.get("num_objects", 1), 1)
        super().__init__(EnvConfig.from_keywords({"num_objects": 1, "control_mode": "ee", **keywords}))

    @property
    def planning_goal(self) -> Goal:
        """The goal of this episode for a planner: the target stands or is held at the goal point.

        Raises:
            ActionError: the environment has not been reset.
        """
        # Imported here, because it takes long and only planning needs it.
        from planners.goals import at, holding
        from planners.scene import Scene

        scene = Scene.from_mujoco(self.model, self.data, self.robot, support=self.support_name)
        body = scene.body(self.target)
        if self._goal[2] - (body.position[2] - body.bottom) <= scene.support.top + _STANDING:
            return at(self.target, self._goal[:2], _PLACE_TOLERANCE)
        return holding(self.target, self._goal, GOAL_TOLERANCE)

    def _draw_scene(self, options: ResetOptions) -> TableScene:
        scene = super()._draw_scene(options)
        if options.objects is None and scene.num_objects == 1:
            x = self.np_random.uniform(*PICK_X)
            scene = replace(scene, positions=np.array([[x, scene.positions[0, 1]]]))
        # The base stands in front of the table, where the object is in reach.
        position = scene.positions[scene.target]
        ahead, side, yaw = self.np_random.uniform(
            (PICK_DISTANCE[0], -PICK_SIDE, -PICK_YAW), (PICK_DISTANCE[1], PICK_SIDE, PICK_YAW)
        )
        x = min(position[0] - ahead, -self.layout.depth / 2 - self.robot.base_radius)
        return replace(scene, base=np.array([x, position[1] + side, yaw]))

    def _achieved(self) -> NDArray[np.float64]:
        return clipped(self.measurements.poses[self.target_slot, :3])

    def _draw_goal(self) -> NDArray[np.float64]:
        start = self._achieved()
        half = np.array([self.layout.depth, self.layout.width]) / 2 - 0.05
        xy = np.clip(start[:2] + self.np_random.uniform(-GOAL_OFFSET, GOAL_OFFSET, 2), -half, half)
        lift = self.np_random.uniform(0.0, GOAL_LIFT) * float(self.np_random.random() < 0.5)
        return np.array([*xy, start[2] + lift])


def distances(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances (...,) of points (..., 3), summed in one fixed order so that every batch size gives the same bits."""
    x, y, z = np.moveaxis(first - second, -1, 0)
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def clipped(point: NDArray[np.float64]) -> NDArray[np.float64]:
    """The point (3,), within the goal space."""
    return np.minimum(np.maximum(point, -GOAL_BOUND), GOAL_BOUND)
