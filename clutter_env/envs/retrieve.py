"""`Retrieve`: lift the target out of the clutter. Also the part that it shares with `Rearrange`."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

from clutter_env.config import EnvConfig
from clutter_env.envs.base import BaseEnv
from clutter_env.envs.reset_options import ResetOptions
from clutter_env.envs.reward import Way, dense_reward, event_terms, potential, potential_terms
from clutter_env.envs.success import HOLD_STEPS, LIFT_HEIGHT
from clutter_env.errors import check_integer
from clutter_env.scene.layout import OPENS
from clutter_env.scene.table_scene import TableScene


class ClutterTaskEnv(BaseEnv):
    """A task amid clutter that ends when it is done. With `success="clean"` it is done only if nothing else has
    happened."""

    _potential: float

    @abstractmethod
    def _is_reached(self) -> bool:
        """Whether the goal is reached, whatever else has happened."""

    @abstractmethod
    def _potential_now(self) -> float:
        """The potential of the present state, which is not terminal."""

    def _stand(self, scene: TableScene, options: ResetOptions) -> TableScene:
        if self.robot.base_drive != "fixed":
            return super()._stand(scene, options)
        # The other robots do without the planner, which takes longer to import than all else here.
        from clutter_env.envs.standing import stand

        return stand(self._world_for(scene), scene, options.base)

    def _advance(self) -> tuple[float, bool]:
        is_success, is_over = self._is_success(), self._is_over()
        if self.config.reward_mode == "sparse":
            return float(is_success), is_over
        before, self._potential = self._potential, self._measure_potential()
        return dense_reward(before, self._potential, event_terms(self._monitor, is_success, is_over)), is_over

    def _is_success(self) -> bool:
        return (
            self._is_reached()
            and not self.world.is_unstable
            and (self.config.success == "lifted" or self._monitor.is_clean)
        )

    @abstractmethod
    def _is_over(self) -> bool:
        """Whether the present state is terminal."""

    def _measure_potential(self) -> float:
        """The potential of the present state. 0 if it is terminal, or with the sparse reward, which has none."""
        return 0.0 if self.config.reward_mode == "sparse" or self._is_over() else self._potential_now()


class RetrieveEnv(ClutterTaskEnv):
    """A mobile manipulator in front of a cluttered table. The target must be lifted 0.10 m and held there for 0.5 s.

    Keyword arguments are the fields of `EnvConfig`. Reset options: `target` (an object's name), `objects` (an explicit
    scene, see `reset_options.explicit_scene`), `state` (bytes from `save_state`), `base` (x, y [m], yaw [rad] of a
    robot with base="fixed"). With `success="clean"` the task is done only if no object has fallen or been disturbed,
    and the robot has not pressed hard on the furniture. With "lifted" it is done in any case, see `success`. The info
    of `reset` and of every step has:

    - `is_success` (bool): the task is done. `lifted` (bool): the target is lifted, whatever else has happened.
    - `target`, `held` (str): names of the target and of the held object, "" without it.
    - `num_fallen`, `num_disturbed`, `num_cleared` (int): numbers of objects since reset.
    - `furniture_force`, `self_force` (float): [N] largest mean force over 0.1 s of the robot, or of objects it moves,
      on furniture, and of the robot on itself and on the ground.
    - `furniture_impulse`, `self_impulse` (float): [N s] largest impulse of these forces beyond 50 N.
    - `total_slide` (float): [m] by which all of these forces together would slide a table of 10 kg, see
      `simulation.pressing`.
    - `total_path` (float): [m] moved by all objects except the target, while not carried.
    - `num_opened` (int), `joint_positions` (dict), in a layout with a drawer or a door: number of open ones, and the
      position of each joint by its name, [m] or [rad].
    - `unstable` (bool): MuJoCo has warned since reset, and the episode is truncated.
    - `ik_failures` (int): failures of differential inverse kinematics since reset, 0 in "joint" mode.

    The episode ends with success, when the target has fallen off the table, or, with `terminate_on_fallen`, when an
    object has fallen.

    Example:
        >>> import gymnasium as gym, clutter_env
        >>> env = gym.make("clutter_env/Retrieve-o5-v0")
        >>> observation, info = env.reset(seed=0)
        >>> sorted(observation)
        ['goal', 'gripper', 'objects', 'robot', 'tcp']
    """

    config_type: ClassVar[type[EnvConfig]] = EnvConfig
    """Of the keyword arguments."""
    opens: ClassVar[tuple[str | None, ...]] = OPENS

    def __init__(self, **keywords: Any) -> None:
        check_integer("num_objects", keywords.get("num_objects", 1), 1)
        super().__init__(self.config_type.from_keywords(keywords))
        self._potential, self._way = 0.0, Way(self.robot.full_name, self.layout)

    def _begin(self) -> None:
        self._potential = self._measure_potential()

    def _observe(self) -> dict[str, Any]:
        hold = min(self._monitor.steps_held / HOLD_STEPS, 1.0)
        return self.observe_world(self.target_slot, hold, LIFT_HEIGHT - self._monitor.lift)

    def _is_reached(self) -> bool:
        return self._monitor.lifted

    def _is_over(self) -> bool:
        is_spoilt = self.config.terminate_on_fallen and self._monitor.num_fallen > 0
        return self._is_success() or self._monitor.is_target_lost or is_spoilt

    def _recall(self, bookkeeping: None) -> None:  # noqa: ARG002  the task remembers nothing
        self._potential = self._measure_potential()

    def _potential_now(self) -> float:
        clearances = self._way.clearances(self.world, self.measurements)
        if self.world.openings and self.target_slot not in self.measurements.grip.held:
            opened = self.world.opened_around(self.measurements, self.target_slot)
            clearances += max(1.0 - opened, 0.0)  # shut, it is one thing that is in the way
        return potential(potential_terms(self.world, self.measurements, self._monitor, clearances))
