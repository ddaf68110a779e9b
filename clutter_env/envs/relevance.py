"""Objects in the order of their relevance: the target first, the others by their distance to it at the reset.

The order stays the same for a whole episode, so that no two rows swap while a network looks at them. Positions are
relative to the target and to the gripper. In slot order, which says nothing, networks fail that have to relate objects
to each other: docs/train_your_own.md has what was measured.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from clutter_env.config import REWARD_MODES, EnvConfig
from clutter_env.envs.observation import POSITION_BOUND, Column, EntryLayout
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.envs.reward import potential_terms
from clutter_env.envs.staged_reward import stage_terms, staged_reward
from clutter_env.envs.success import HOLD_STEPS
from clutter_env.errors import StateError
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.saved_state import Fields

OBJECT_ORDERS = ("slots", "relevance")
"""Orders of the objects in an observation: as the scene numbers them, or the target first, the others by distance."""

_FROM_TCP = [Column(f"from_tcp_{axis}", "m", POSITION_BOUND) for axis in "xyz"]


def relevance_order(positions: ArrayLike, target: int) -> tuple[int, ...]:
    """Indices of objects: the target, then the others from the nearest to it to the farthest.

    Equally distant ones keep their order.

    Args:
        positions: (n, 2) or (n, 3) [m]. Only the first two columns count.
        target: index of the target.
    """
    offsets = np.asarray(positions, np.float64)[:, :2] - np.asarray(positions, np.float64)[target, :2]
    squared = offsets[:, 0] ** 2 + offsets[:, 1] ** 2
    squared[target] = -1.0
    return tuple(np.argsort(squared, kind="stable").tolist())


def relevant_layout(row: EntryLayout) -> EntryLayout:
    """The layout of an object's row here: that of `Observer`, and after it the position relative to the TCP."""
    columns = {name: list(row.columns[place]) for name, place in row.items()}
    return EntryLayout({**columns, "from_tcp": _FROM_TCP})


def relevant_rows(
    objects: NDArray[np.float32], tcp: NDArray[np.float32], order: tuple[int, ...], row: EntryLayout
) -> NDArray[np.float32]:
    """The entry "objects" of observations, in the order of relevance.

    "position" is relative to the target, that of the target itself to the base. "from_tcp" is relative to the TCP. Rows
    without an object stay zero. It works on one observation and on those of a whole episode alike.

    Args:
        objects: (..., n k), rows in the order of the slots.
        tcp: (..., 7), of which the first three are the TCP's position.
        order: slots of the objects that are there, from `relevance_order` at the episode's first state.
        row: the layout of the k columns.

    Returns:
        (..., n (k + 3)) float32.
    """
    rows = objects.reshape(*objects.shape[:-1], -1, row.size)
    found = np.zeros((*rows.shape[:-1], row.size + len(_FROM_TCP)), np.float32)
    found[..., : len(order), : row.size] = rows[..., list(order), :]
    place, present = row["position"], slice(0, len(order))
    positions = found[..., present, place].copy()
    found[..., present, row.size :] = positions - tcp[..., None, :3]
    found[..., present, place][..., 1:, :] -= positions[..., :1, :]
    bounds = relevant_layout(row).bounds.astype(np.float32)
    return np.clip(found, -bounds, bounds).reshape(*objects.shape[:-1], -1)


@dataclass(frozen=True)
class RelevantConfig(EnvConfig):
    """The keyword arguments of `RelevantRetrieveEnv`: those of `EnvConfig`. The reward may be "staged" too."""

    @property
    def reward_modes(self) -> tuple[str, ...]:
        """Values of `reward_mode` here."""
        return (*REWARD_MODES, "staged")


class StagedRetrieveEnv(RetrieveEnv):
    """Base of the retrieval environments for learners: an order of the objects, and the staged reward.

    The order is that of an episode's first state. Saved states keep it. With reward_mode="staged" the reward is that of
    `staged_reward`, and the info has its terms, `reward_terms`.
    """

    task_modules: ClassVar[tuple[str, ...]] = ("clutter_env.envs.staged_reward",)
    _order: tuple[int, ...] = ()
    _terms: Mapping[str, float] = MappingProxyType({})
    """Terms of the present state."""

    @property
    def object_order(self) -> tuple[int, ...]:
        """Slots of the objects in the order of this episode's rows."""
        return self._order

    @abstractmethod
    def _find_order(self) -> tuple[int, ...]:
        """The order of the objects in the episode's first state."""

    @abstractmethod
    def _measure_terms(self) -> dict[str, float]:
        """The terms of the staged reward in the present state."""

    @property
    def _is_staged(self) -> bool:
        return self.config.reward_mode == "staged"

    def _begin(self) -> None:
        self._order = self._find_order()
        super()._begin()
        self._follow_terms()

    def _advance(self) -> tuple[float, bool]:
        if not self._is_staged:
            return super()._advance()
        self._follow_terms()
        return staged_reward(self._terms, self._is_success()), self._is_over()

    def _follow_terms(self) -> None:
        if self._is_staged:
            self._terms = self._measure_terms()

    def _measure_potential(self) -> float:
        return 0.0 if self._is_staged else super()._measure_potential()

    def _info(self) -> dict[str, Any]:
        info = super()._info()
        return {**info, "reward_terms": dict(self._terms)} if self._is_staged else info

    def _memory(self) -> dict[str, Any]:
        return {"order": list(self._order)}

    def _read_memory(self, memory: Any, scene: TableScene) -> tuple[int, ...]:
        """The order in the memory of a saved state.

        Raises:
            StateError: it is no order of the scene's objects.
        """
        count = scene.num_objects
        order = Fields(memory, "memory task", ("order",)).integers("order", count, 0, max(count - 1, 0)).tolist()
        if sorted(order) != list(range(count)):
            raise StateError("memory task: order of the state must hold every object once")
        return tuple(order)

    def _recall(self, bookkeeping: Any) -> None:
        self._order = bookkeeping
        super()._recall(None)
        self._follow_terms()


class RelevantRetrieveEnv(StagedRetrieveEnv):
    """`RetrieveEnv` whose observation has the objects in the order of relevance. See `relevant_rows`.

    `gym.make("clutter_env/Retrieve-o5-v0", object_order="relevance")` makes one. The reward may be "staged" too.
    Everything else is as there.
    """

    config_type: ClassVar[type[EnvConfig]] = RelevantConfig

    @property
    def observation_layout(self) -> Mapping[str, EntryLayout]:
        """The layout of the observation's entries. Rows of "objects" have three columns more."""
        layout = super().observation_layout
        return MappingProxyType({**layout, "objects": relevant_layout(layout["objects"])})

    def _find_order(self) -> tuple[int, ...]:
        return relevance_order(self.measurements.poses, self.target_slot)

    def _observe(self) -> dict[str, Any]:
        observation = super()._observe()
        if "objects" in observation:
            row = self._observer.layout["objects"]
            observation["objects"] = relevant_rows(observation["objects"], observation["tcp"], self._order, row)
        return observation

    def _measure_terms(self) -> dict[str, float]:
        clearances = self._way.clearances(self.world, self.measurements)
        terms = potential_terms(self.world, self.measurements, self._monitor, clearances)
        grasp, hold = terms["grasp"], min(self._monitor.steps_held / HOLD_STEPS, 1.0)
        count = self.world.scene.num_objects
        return stage_terms(terms["way"], terms["reach"], grasp, grasp, terms["lift"], hold, count)

    def _make_observation_space(self) -> spaces.Dict:
        space = super()._make_observation_space()
        if "objects" not in space.spaces:
            return space
        bound = np.tile(self.observation_layout["objects"].bounds, self.config.num_objects).astype(np.float32)
        return spaces.Dict({**space.spaces, "objects": spaces.Box(-bound, bound, dtype=np.float32)})
