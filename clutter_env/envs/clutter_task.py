"""What `Retrieve` and `Rearrange` share: when what is reached is a success, and the reward with its potential."""

from __future__ import annotations

from abc import abstractmethod

from clutter_env.envs.base import BaseEnv
from clutter_env.envs.reset_options import ResetOptions
from clutter_env.envs.reward import dense_reward, event_terms
from clutter_env.scene.table_scene import TableScene


class ClutterTaskEnv(BaseEnv):
    """A task amid clutter, done when it is reached; with `success="clean"` only if nothing else has happened."""

    _potential: float

    @abstractmethod
    def _is_reached(self) -> bool:
        """Whether what is wanted has come about, whatever else has happened."""

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
        """The potential of the present state, 0 if it is terminal; 0 with the sparse reward, which has none."""
        return 0.0 if self.config.reward_mode == "sparse" or self._is_over() else self._potential_now()
