"""`Retrieve`: lift the target out of the clutter."""

from __future__ import annotations

from typing import Any, ClassVar

from clutter_env.config import EnvConfig
from clutter_env.envs.clutter_task import ClutterTaskEnv
from clutter_env.envs.reward import Way, potential, potential_terms
from clutter_env.envs.success import HOLD_STEPS, LIFT_HEIGHT
from clutter_env.errors import check_integer


class RetrieveEnv(ClutterTaskEnv):
    """A mobile manipulator before a cluttered table; the target must be lifted 0.10 m and held there for 0.5 s.

    Keyword arguments are the fields of `EnvConfig`. Reset options: `target` (an object's name), `objects` (an explicit
    scene, see `reset_options.explicit_scene`), `state` (bytes from `save_state`), `base` (x, y [m], yaw [rad] of a
    robot with base="fixed"). With `success="clean"` the task is done only if nothing has fallen or been disturbed and
    the robot has not pressed hard on the furniture, with "lifted" in any case; see `success`. The info of `reset` and
    of every step has:

    - `is_success`, `lifted` (bool): the task is done; the target is lifted, whatever else has happened.
    - `target`, `held` (str): names of the target and of what is held, "" without it.
    - `num_fallen`, `num_disturbed`, `num_cleared` (int): numbers of objects since reset.
    - `furniture_force` (float): [N] largest force of the robot on furniture since reset.
    - `unstable` (bool): MuJoCo has warned since reset; the episode is truncated.
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
        return potential(potential_terms(self.world, self.measurements, self._monitor, clearances))
