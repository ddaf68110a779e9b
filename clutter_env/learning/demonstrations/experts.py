"""Experts behind one interface: the task and motion planner, and scripts for the goal environments."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.demonstrations.scripted import SCRIPTS
from clutter_env.learning.errors import UnknownExpert
from clutter_env.learning.task import family

__all__ = ["Expert", "expert_names", "make_expert"]

STRATEGY_NAMES = ("lookahead", "ngr", "dogar", "srivastava")
"""Strategies of the planner; known here without importing it."""

PATIENCE = 400
"""Steps after which a script gives up; it needs about a hundred."""


class Expert(Protocol):
    """Acts in one environment, which it may look into."""

    @property
    def done(self) -> bool:
        """Whether it has finished or given up."""
        ...

    @property
    def skill(self) -> str:
        """Name of what the last action belonged to."""
        ...

    @property
    def plan_text(self) -> str:
        """The plan, one action a line."""
        ...

    @property
    def report_values(self) -> Mapping[str, Any]:
        """The report as JSON values."""
        ...

    def reset(self) -> None:
        """Take up the episode that the environment has just begun."""
        ...

    def act(self) -> NDArray[Any]:
        """The next action."""
        ...


def expert_names(env_id: str) -> tuple[str, ...]:
    """The experts that know an environment; none acts by skills."""
    kind = family(env_id)
    if kind == "skill":
        return ()
    return (kind,) if kind in SCRIPTS else (*STRATEGY_NAMES, "front")


def make_expert(env: gym.Env, name: str = "") -> Expert:
    """An expert for an environment: a strategy of the planner, or the script of a goal environment; "" is the first.

    Raises:
        UnknownExpert: no such expert for this environment; the message lists those there are.
    """
    assert env.spec is not None
    known = expert_names(env.spec.id)
    if not known:
        raise UnknownExpert(
            f"no expert acts in {env.spec.id}; those of the Retrieve environments act in the same scenes"
        )
    if name and name not in known:
        raise UnknownExpert(f"no expert {name!r} for {env.spec.id}; known ones: {', '.join(known)}")
    chosen = name or known[0]
    if chosen in SCRIPTS:
        return ScriptedExpert(env, chosen)
    return PlannerExpert(env, chosen)


class ScriptedExpert:
    """One of `SCRIPTS`: a function from the environment to its next action, with the name of the phase it is in.

    Raises:
        UnknownExpert: the environment is not controlled by the hand's velocity.
    """

    def __init__(self, env: gym.Env, name: str) -> None:
        if env.unwrapped.config.control_mode != "ee":  # type: ignore[attr-defined]
            raise UnknownExpert(f"the script {name!r} needs control_mode='ee'")
        self._env, self._name = env, name
        self.skill = ""
        self.done = False
        self.plan_text = name
        self.report_values: Mapping[str, Any] = {}

    def reset(self) -> None:
        """Begin anew."""
        self._script = SCRIPTS[self._name](self._env.unwrapped)
        self._steps = 0
        self.done = False

    def act(self) -> NDArray[Any]:
        """The next action."""
        self._steps += 1
        self.done = self._steps >= PATIENCE
        self.skill, action = self._script()
        return action


class PlannerExpert:
    """`planners.TampExpert`, imported when it is first needed.

    It gives up after so many task plans and clearances, not by the clock: a loaded machine finds the same plans.
    """

    def __init__(self, env: gym.Env, strategy: str) -> None:
        from planners.execution.expert import ExpertConfig, TampExpert

        self._expert = TampExpert(env, strategy=strategy, config=ExpertConfig(planning_s=math.inf))

    @property
    def done(self) -> bool:
        """Whether the planner has finished or given up."""
        return bool(self._expert.done)

    @property
    def skill(self) -> str:
        """The action and the phase of its motion, such as "PickUp object_03: lift"."""
        return str(self._expert.phase)

    @property
    def plan_text(self) -> str:
        """The last plan, as in Fig. 13 of Lee & Kim 2019."""
        return "\n".join(str(action) for action in getattr(self._expert.solution, "actions", ()))

    @property
    def report_values(self) -> Mapping[str, Any]:
        """`EpisodeReport` as JSON values."""
        return json_values(self._expert.report)

    def reset(self) -> None:
        """Plan for the episode that has just begun."""
        self._expert.reset()

    def act(self) -> NDArray[Any]:
        """The next action."""
        return np.asarray(self._expert.act())


def json_values(value: Any) -> dict[str, Any]:
    """A dataclass as JSON values; what JSON does not know becomes text."""
    return dict(json.loads(json.dumps(dataclasses.asdict(value), default=str)))
