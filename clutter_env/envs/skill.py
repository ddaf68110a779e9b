"""`Skill`: one step is one skill, clearing an object from a direction or taking the target.

The planner's motion layer turns a skill into motions. They are executed in physics, or assumed to
succeed on a kinematic model: the object is put where the plan would put it, and no time passes.
"""

from __future__ import annotations

import math
from functools import cached_property
from itertools import compress
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from clutter_env import skill_budget
from clutter_env.envs.base import restored_generator
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.envs.success import is_as_placed
from clutter_env.errors import ActionError, ConfigError, check_choice, check_integer
from planners import (
    DIRECTIONS,
    Body,
    Command,
    MonitorConfig,
    Scene,
    Sensor,
    Skill,
    SkillFailure,
    SkillPlanner,
    follow,
)

SIMULATIONS = ("physics", "kinematic")
FEASIBILITIES = ("oracle", "none")
_PUSHING = MonitorConfig(displacement=math.inf, tilt=math.pi)
"""Tolerances of an attempt that runs into objects: their motion does not stop it."""
SKILL_COST = 0.05
"""Reward lost by every skill. Success is worth 1."""
FINAL_HOLD_STEPS = 20
"""Control steps for which the target is held up in the end, if that is not success yet."""
BODY_FIELDS = ("present", "x", "y", "half_x", "half_y", "height", "is_box")
"""Columns of an object's row before its `DIRECTIONS` flags of failed attempts."""
LENGTH_UNIT = 0.1
"""[m] Unit of the lengths in a row: the numbers that a network sees are of the order of one."""

_POSITION_BOUND = 4.0 / LENGTH_UNIT


def observed_masks(observation: NDArray[np.float32]) -> NDArray[np.bool_]:
    """`SkillEnv.action_masks(geometric=False)` (n,), from an observation of the environment."""
    rows = observation[:-2].reshape(-1, len(BODY_FIELDS) + DIRECTIONS)
    can_be_cleared = rows[:, 0] > 0
    can_be_cleared[0] = False  # the target
    mask = np.append((rows[:, len(BODY_FIELDS) :] == 0) & can_be_cleared[:, None], observation[-1] == 0)
    mask[-1] |= not mask.any()
    return mask


class SkillEnv(gym.Env[NDArray[np.float32], np.int64]):
    """Retrieve the target by skills.

    The observation is a row per object, then the share of the budget left and the flag of a failed attempt to take. A
    row has `BODY_FIELDS`, then a flag per direction for an attempt that failed since an object was last cleared. Row 0
    is the target's, with x and y in the world. The others follow in the order of their distance from it, with x and y
    relative to it. Rows of fallen and of missing objects are zero and come last. Action `i * DIRECTIONS + d` clears the
    object of row i from direction d. The last action takes the target by any possible grasp.

    Episodes end with the target taken, with the target lost, or when the budget is spent. A taken target is success if
    nothing has fallen or been disturbed, with `success="lifted"` in any case. The reward is 1 for success less
    `SKILL_COST` for every skill. `info` has the keys of `RetrieveEnv`'s and three more: `failure` (reason why the last
    skill failed, "" if it did not), `moved` (names of the objects cleared so far, in order) and `num_refused` (skills
    so far that moved nothing).

    With `feasibility="oracle"` a skill without a free grasp is refused, and costs only its share of the budget. With
    "none" it is tried by its least obstructed grasp. In physics this pushes the objects in the way. On the kinematic
    model they are regarded as disturbed, and the episode ends, because the model does not know where they would be.

    Keyword arguments: `simulation` ("physics" or "kinematic"), `budget` (skills), `geometric_mask` (what `action_masks`
    says), `feasibility`, and those of `RetrieveEnv` except `control_mode`.

    Attributes:
        physics_env: the environment in which skills are carried out.
        actions: the skills since the reset.
    """

    metadata: dict[str, Any] = RetrieveEnv.metadata

    def __init__(
        self,
        simulation: Literal["physics", "kinematic"] = "physics",
        budget: int | None = None,
        geometric_mask: bool = False,
        feasibility: Literal["oracle", "none"] = "oracle",
        **keywords: Any,
    ) -> None:
        check_choice("simulation", simulation, SIMULATIONS)
        check_choice("feasibility", feasibility, FEASIBILITIES)
        self.physics_env = RetrieveEnv(**{**keywords, "control_mode": "joint"})
        if self.physics_env.robot.acts_with_all_arms:
            raise ConfigError(f"skills use one arm; give robot {self.physics_env.robot.name!r} without with_all_arms()")
        check_choice("reality", self.physics_env.config.reality, (0.0,))
        self._is_kinematic = simulation == "kinematic"
        self._geometric_mask, self._tries_all = geometric_mask, feasibility == "none"
        self._count = self.physics_env.config.num_objects
        self.budget = skill_budget(self._count) if budget is None else budget
        check_integer("budget", self.budget, 1)
        self.render_mode, self.metadata = self.physics_env.render_mode, self.physics_env.metadata
        self._size = self._count * DIRECTIONS + 1
        self.action_space = spaces.Discrete(self._size)
        row = [1.0, _POSITION_BOUND, _POSITION_BOUND, *[1.0 / LENGTH_UNIT] * 3, 1.0] + [1.0] * DIRECTIONS
        bound = np.array(row * self._count + [1.0, 1.0], np.float32)
        self.observation_space = spaces.Box(-bound, bound, dtype=np.float32)

    # The Gymnasium surface.

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode on the scene that `RetrieveEnv` draws for the seed and options.

        Raises:
            OptionError: an unknown or invalid option.
        """
        with restored_generator(self):
            super().reset(seed=seed)
            _, info = self.physics_env.reset(seed=seed, options=options)
        self._target: str = info["target"]
        names, table_scene = self.physics_env.world.names, self.physics_env.world.scene
        self._lying = frozenset(compress(names, table_scene.is_lying))
        self._rng = np.random.default_rng(self.np_random.integers(2**32))
        self._read_scene()
        if self.physics_env.robot.base_drive == "fixed":  # stands elsewhere in every episode
            self.__dict__.pop("_planner", None)
        self._clear_failed = np.zeros((self._count, DIRECTIONS), dtype=np.bool_)
        self._take_failed = False
        self.actions: list[int] = []
        self._left = self.budget
        self._moved: list[str] = []
        self._num_refused, self._num_hit = 0, 0
        self._is_taken = self._is_physics_over = False
        return self._observe(), self._info("")

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Try one skill.

        Raises:
            ActionError: not an action of the action space, or `reset` has not been called. Nothing has changed.
        """
        number = self._checked(action)
        self._left -= 1
        self.actions.append(number)
        if number // DIRECTIONS in range(
            len(self._scene.names), self._count
        ):  # described scenes may have fewer objects
            self._num_refused += 1
            return self._outcome("absent")
        skill = self.skill(number)
        failure = self._simulate_kinematically(skill) if self._is_kinematic else self._carry_out(skill)
        if failure and skill.direction is None:
            self._take_failed = True
        elif failure:
            self._clear_failed[self._scene.names.index(skill.object), skill.direction] = True
        elif skill.direction is not None:
            self._clear_failed[:] = self._take_failed = False
            self._moved.append(skill.object)
        return self._outcome(failure)

    def _outcome(self, failure: str) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """The result of `step` after a skill that failed for this reason, "" if it did not fail."""
        info = self._info(failure)
        is_lost = not self._is_taken and not self._is_placed(self._scene.body(self._target))
        is_over = self._is_taken or is_lost or self._is_physics_over or self._num_hit > 0 or self._left == 0
        return self._observe(), float(info["is_success"]) - SKILL_COST, is_over, False, info

    def render(self) -> Any:
        """Render as `RetrieveEnv.render` does. With the kinematic model the images show the first state."""
        return self.physics_env.render()

    def close(self) -> None:
        """Free the OpenGL resources."""
        self.physics_env.close()

    # Beyond Gymnasium.

    def __getstate__(self) -> dict[str, Any]:
        """All attributes except the planner. Its prepared data cannot be pickled, and are made again when needed."""
        return {name: value for name, value in self.__dict__.items() if name != "_planner"}

    def skill(self, action: Any) -> Skill:
        """The skill that an action means now.

        Raises:
            ActionError: not an action of the action space, of a row without an object, or `reset` has not been called.
        """
        row, direction = divmod(self._checked(action), DIRECTIONS)
        if row == self._count:
            return Skill(self._target)
        if row >= len(order := self._order()):
            raise ActionError(f"row {row} has no object; this scene has {len(order)}")
        return Skill(self._scene.names[order[row]], direction)

    def _checked(self, action: Any) -> int:
        """The action as an integer. Raise ActionError."""
        self.physics_env.check_started("skill()")
        value = np.asarray(action)
        if value.shape != () or value.dtype.kind not in "iu" or not 0 <= int(value) < self._size:
            raise ActionError(f"the action must be an integer from 0 to {self._size - 1}, not {action!r}")
        return int(value)

    def action_masks(self, geometric: bool | None = None) -> NDArray[np.bool_]:
        """Mask (n,) of actions worth trying: objects that stand on the table, attempts that have not just failed.

        Args:
            geometric: also leave out skills without a free grasp. The default is the environment's keyword argument.
        """
        self.physics_env.check_started("action_masks()")
        mask = observed_masks(self._observe())
        is_geometric = self._geometric_mask if geometric is None else geometric
        if is_geometric:
            for index in np.flatnonzero(mask):
                mask[index] = not isinstance(self._planner.grasps(self._scene, self.skill(int(index))), SkillFailure)
            mask[-1] |= not mask.any()
        return mask

    @property
    def scene(self) -> Scene:
        """The scene that the planner works on now."""
        self.physics_env.check_started("scene")
        return self._scene

    @property
    def target(self) -> str:
        """Name of the target."""
        self.physics_env.check_started("target")
        return self._target

    # Private.

    def _read_scene(self) -> None:
        env, held = self.physics_env, self.physics_env.measurements.held
        name = env.world.names[held] if held >= 0 else ""
        self._scene = Scene.from_mujoco(env.model, env.data, env.robot, held=name)

    @cached_property
    def _planner(self) -> SkillPlanner:
        """The planner of this robot and table. It is prepared once, for the scenes of all episodes."""
        return SkillPlanner.of(self._scene)

    def _simulate_kinematically(self, skill: Skill) -> str:
        result = self._planner.simulate_kinematically(self._scene, self._target, skill, self._rng)
        if isinstance(result, SkillFailure):
            if result.reason == "blocked" and self._tries_all:
                self._num_hit = len(self._planner.in_the_way(self._scene, skill))
                return "collision"
            self._num_refused += 1
            return result.reason
        self._scene = result
        self._is_taken = skill.direction is None
        return ""

    def _carry_out(self, skill: Skill) -> str:
        config = MonitorConfig()
        actions = self._planner.plan(self._scene, self._target, skill, self._rng)
        if isinstance(actions, SkillFailure) and actions.reason == "blocked" and self._tries_all:
            actions, config = self._planner.plan_through(self._scene, self._target, skill, self._rng), _PUSHING
        if isinstance(actions, SkillFailure):
            self._num_refused += 1
            return actions.reason
        physics_env = self.physics_env
        sensor = Sensor(physics_env.model, physics_env.data, physics_env.robot, self._scene.names)

        def command(wanted: Command) -> bool:
            return self._step_physics(physics_env.joint_action(wanted.drive, wanted.opening))

        stopped_by = follow(actions, physics_env.robot, sensor, command, config).deviation
        deviation = "" if stopped_by is None else str(stopped_by.kind)
        if skill.direction is None and not deviation:
            controller = physics_env.world.controller
            for _ in range(FINAL_HOLD_STEPS):  # stand still and hold the target
                if self._is_taken or self._step_physics(physics_env.joint_action(controller.state.target, 0.0)):
                    break
        self._read_scene()
        if deviation or self._is_taken or skill.direction is not None:
            return deviation
        return "not held"

    def _step_physics(self, action: NDArray[np.float64]) -> bool:
        """Execute one control step. Return whether the episode of the physics environment is over."""
        _, _, self._is_physics_over, _, info = self.physics_env.step(action)
        self._is_taken = info["lifted"]
        return self._is_physics_over or self._is_taken

    def _order(self) -> list[int]:
        """The objects of the rows: the target, then the others by distance from it, fallen objects last."""
        bodies, target = self._scene.objects, self._scene.body(self._target)

        def key(i: int) -> tuple[bool, bool, float]:
            distance = np.linalg.norm(bodies[i].position[:2] - target.position[:2])
            return bodies[i].name != self._target, not self._is_placed(bodies[i]), float(distance)

        return sorted(range(len(bodies)), key=key)

    def _is_placed(self, body: Body) -> bool:
        """Whether it has neither toppled nor left the table."""
        return is_as_placed(body.quaternion, body.bottom, body.name in self._lying)

    def _observe(self) -> NDArray[np.float32]:
        rows = np.zeros((self._count, len(BODY_FIELDS) + DIRECTIONS), np.float32)
        order = self._order()
        origin = np.zeros(2)  # of the first row, the target's
        for row, i in zip(rows, order, strict=False):  # a scene that was described may have fewer objects
            body = self._scene.objects[i]
            if not self._is_placed(body):
                continue
            x, y = np.clip((body.position[:2] - origin) / LENGTH_UNIT, -_POSITION_BOUND, _POSITION_BOUND)
            half_x, half_y, half_z = body.half_extents / LENGTH_UNIT
            row[:] = 1, x, y, half_x, half_y, 2 * half_z, body.shape == "box", *self._clear_failed[i]
            if i == order[0]:
                origin = body.position[:2]
        return np.append(rows, (self._left / self.budget, self._take_failed)).astype(np.float32)

    def _info(self, failure: str) -> dict[str, Any]:
        info = self.physics_env.info
        if self._is_kinematic:  # the physics stays in the first state
            info |= {
                "is_success": self._is_taken,
                "lifted": self._is_taken,
                "held": self._scene.held.name if self._scene.held is not None else "",
                "num_disturbed": self._num_hit,
                "num_cleared": len(set(self._moved)),
            }
        return {**info, "failure": failure, "moved": tuple(self._moved), "num_refused": self._num_refused}
