"""`Open`: open a drawer or a door by its handle."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from clutter_env.config import EnvConfig
from clutter_env.envs.reset_options import ResetOptions
from clutter_env.envs.retrieve import ClutterTaskEnv
from clutter_env.envs.reward import REACH_SCALE
from clutter_env.envs.success import HOLD_STEPS, OPENED_SHARE
from clutter_env.errors import OptionError, check_choice
from clutter_env.scene.layout import OPENS
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.saved_state import Fields
from clutter_env.simulation.world import World

if TYPE_CHECKING:
    from planners.goals import Goal

POTENTIAL_SCALES: Mapping[str, float] = MappingProxyType({"reach": 0.1, "open": 0.6})
"""Weight of each term of the potential, each between 0 and 1. Their sum is `reward.MOST`."""
_OPTIONS = ("objects", "state")


@dataclass(frozen=True)
class OpenConfig(EnvConfig):
    """The keyword arguments of `OpenEnv`: those of `EnvConfig`.

    Raises:
        ConfigError: see `EnvConfig`. Or `obstructed`, or a fixed base, is given.
    """

    num_objects: int = 5
    layout: Any = "drawer"
    """A layout in which something opens: "drawer", "cupboard", "fridge", "blocked_drawer", or one of the user's."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("obstructed", self.obstructed, (False,))
        check_choice("base", self.base, ("holonomic", "differential"))


class OpenEnv(ClutterTaskEnv):
    """A mobile manipulator in front of a closed drawer or door, with objects behind it.

    It is open when its joint has been at 80% of its range or beyond for 0.5 s. The robot may still hold the handle or
    have let go. With `success="clean"` nothing may have toppled, or travelled other than in the air, in the gripper.
    The robot may not have pressed hard on the furniture. Objects in a drawer move with it, and fingers may pull at the
    handle with any force, see `success`. Keyword arguments are the fields of `OpenConfig`. Reset options: `objects` and
    `state`. The info has the keys of `RetrieveEnv`'s. `lifted` says that it is open, whatever else has happened, and
    `target` is "". The episode ends with success or, with `terminate_on_fallen`, when an object has fallen.

    Example:
        >>> import gymnasium as gym, clutter_env
        >>> env = gym.make("clutter_env/Open-v0", layout="cupboard")
        >>> observation, info = env.reset(seed=0)
        >>> info["joint_positions"]
        {'door_joint': 0.0}
    """

    config: OpenConfig
    opens = tuple(one for one in OPENS if one not in (None, "drawers"))
    has_target = _shows_goal = False

    def __init__(self, **keywords: Any) -> None:
        super().__init__(OpenConfig.from_keywords(keywords))
        self._steps_open, self._potential = 0, 0.0

    @property
    def goal(self) -> Goal:
        """The goal of this episode for a planner.

        Raises:
            ActionError: `reset` has not been called.
        """
        self.check_started("goal")
        assert self.world.opening is not None
        return _opening_goal(self.world.opening.name)

    def _check_options(self, options: object) -> ResetOptions:
        for name in options if isinstance(options, Mapping) else ():
            if name not in _OPTIONS:
                raise OptionError(f"unknown option {name!r}; known options: {', '.join(_OPTIONS)}")
        return super()._check_options(options)

    def _draw_scene(self, options: ResetOptions) -> TableScene:
        return replace(super()._draw_scene(options), target=-1)

    def _begin(self) -> None:
        self._steps_open = 0
        self._potential = self._measure_potential()

    def _advance(self) -> tuple[float, bool]:
        self._steps_open = self._steps_open + 1 if self.world.opened >= OPENED_SHARE else 0
        return super()._advance()

    def _observe(self) -> dict[str, Any]:
        return self.observe_world(-1, 0.0, 0.0)

    def _info(self) -> dict[str, Any]:
        return {**super()._info(), "lifted": self._is_reached()}

    def _is_reached(self) -> bool:
        return self._steps_open >= HOLD_STEPS

    def _is_over(self) -> bool:
        return self._is_success() or (self.config.terminate_on_fallen and self._monitor.num_fallen > 0)

    def _memory(self) -> dict[str, Any]:
        return {"steps_open": self._steps_open}

    def _read_memory(self, memory: Any, scene: TableScene) -> int:  # noqa: ARG002  as of other tasks
        return Fields(memory, "memory task", ("steps_open",)).integer("steps_open", 0, 2**31)

    def _recall(self, bookkeeping: int) -> None:
        self._steps_open = bookkeeping
        self._potential = self._measure_potential()

    def _potential_now(self) -> float:
        terms = potential_terms(self.world)
        return sum(scale * terms[name] for name, scale in POTENTIAL_SCALES.items())


def potential_terms(world: World) -> dict[str, float]:
    """The terms of the potential of a state, each between 0 and 1: how near the handle is, and how far it is open."""
    assert world.opening is not None
    handle = world.data.geom_xpos[world.model.geom(world.opening.bar).id]
    distance = math.dist(world.data.site_xpos[world.index.tcp_site], handle)
    return {
        "reach": 1.0 - math.tanh(REACH_SCALE * distance),
        "open": min(max(world.opened / OPENED_SHARE, 0.0), 1.0),
    }


def _opening_goal(name: str) -> Goal:
    """That a drawer or a door is open, as planners say it."""
    # Who does not plan does without the planner, which takes longer to import than all else here.
    from planners.goals import open_

    return open_(name)
