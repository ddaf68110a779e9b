"""`Retrieve`: lift the target out of the clutter."""

from __future__ import annotations

from typing import Any

from clutter_env.config import EnvConfig, check_integer
from clutter_env.envs.base import BaseEnv
from clutter_env.envs.reset_options import ResetOptions, draw_scene
from clutter_env.envs.reward import HOLD_STEPS, LIFT_HEIGHT, Progress, reward
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.state_fields import Fields, read_dataclass

__all__ = ["RetrieveEnv"]


class RetrieveEnv(BaseEnv):
    """A mobile manipulator before a cluttered table; the target must be lifted 0.10 m and held there for 0.5 s.

    Keyword arguments are the fields of `EnvConfig`. Reset options: `target` (an object's name), `objects` (an explicit
    scene, see `reset_options.explicit_scene`), `state` (bytes from `save_state`). The info of `reset` and of every step
    has `is_success`, `target`, `held` and `num_fallen`. The episode ends with success, or when the target has fallen
    off the table.

    Example:
        >>> import gymnasium as gym, clutter_env
        >>> env = gym.make("clutter_env/Retrieve-o5-v0")
        >>> observation, info = env.reset(seed=0)
        >>> sorted(observation)
        ['goal', 'gripper', 'objects', 'robot', 'tcp']
    """

    def __init__(self, **keywords: Any) -> None:
        check_integer("num_objects", keywords.get("num_objects", 1), 1)
        self._progress = Progress()
        super().__init__(EnvConfig.from_keywords(keywords))

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of the objects' bodies."""
        return self.world.names

    @property
    def support_name(self) -> str:
        """Name of the geom on whose top face the objects stand."""
        return "table_top"

    @property
    def lift_height(self) -> float:
        """[m] between the support and the lowest point of the target from which the target counts as lifted."""
        return LIFT_HEIGHT

    def _draw_scene(self, options: ResetOptions) -> TableScene:
        return draw_scene(self.np_random, self.layout, self.config, options)

    def _begin(self) -> None:
        self._progress = Progress().after(self.world, self.measurements, self.target_slot)

    def _advance(self) -> tuple[float, bool]:
        self._progress = self._progress.after(self.world, self.measurements, self.target_slot)
        value = reward(self.config.reward_mode, self.world, self.measurements, self._progress, self.target_slot)
        return value, self._progress.is_success or self._progress.is_target_lost

    def _observe(self) -> dict[str, Any]:
        hold = min(self._progress.steps_held / HOLD_STEPS, 1.0)
        return self.observe_world(self.target_slot, hold, LIFT_HEIGHT - self._progress.lift)

    def _info(self) -> dict[str, Any]:
        held = self.measurements.held
        return {
            "is_success": self._progress.is_success,
            "target": self.world.names[self.target_slot],
            "held": self.world.names[held] if held >= 0 else "",
            "num_fallen": self._progress.num_fallen,
        }

    def _memory(self) -> dict[str, Any]:
        return {"progress": vars(self._progress)}

    def _read_memory(self, memory: Any) -> Progress:
        return read_dataclass(Progress, Fields(memory, "memory task", ("progress",))["progress"], "progress")

    def _recall(self, bookkeeping: Progress) -> None:
        self._progress = bookkeeping
