"""Experts with one interface: the task and motion planner, and the scripts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.demonstrations.scripted import SCRIPTS
from clutter_env.learning.errors import UnknownExpert
from clutter_env.learning.task import family
from clutter_env.reporting.files import json_values

if TYPE_CHECKING:
    from planners import StepLabel

__all__ = ["MAX_SCRIPT_STEPS", "PLANNERS", "Expert", "expert_keywords", "expert_names", "make_expert"]

STRATEGY_NAMES = ("lookahead", "ngr", "dogar", "srivastava")
"""The strategies of the planner, which takes long to import."""


class PlannerChoice(NamedTuple):
    """A strategy, the grasps to choose from, and whether plans are canonical; see `planners.Planner`."""

    strategy: str
    grasps: str = "side"
    canonical: bool = False


_SIDE = {name: PlannerChoice(name) for name in STRATEGY_NAMES} | {
    "canonical": PlannerChoice("lookahead", canonical=True)
}
PLANNERS: Mapping[str, PlannerChoice] = MappingProxyType(
    _SIDE | {f"{name}-all": choice._replace(grasps="all") for name, choice in _SIDE.items()}
)
"""Experts that plan, by name: those "…-all" choose from all grasps, the others from side grasps. "canonical" looks
ahead too, and makes plans that can be learned."""

MAX_SCRIPT_STEPS = 400
"""Steps after which a script gives up; it needs about a hundred."""


class Expert(Protocol):
    """Acts in one environment; it may read the state of the simulation."""

    @property
    def done(self) -> bool:
        """Whether it has finished or given up."""
        ...

    @property
    def skill(self) -> str:
        """Name of the skill that the last action belongs to."""
        ...

    @property
    def step_label(self) -> StepLabel | None:
        """Phase, contact and keyframe that the last action belongs to; None if it has no plan."""
        ...

    @property
    def plan_text(self) -> str:
        """The plan, one action per line."""
        ...

    @property
    def report_values(self) -> Mapping[str, Any]:
        """The report as JSON values."""
        ...

    def reset(self) -> None:
        """Start with the episode for which the environment has just been reset."""
        ...

    def act(self) -> NDArray[Any]:
        """The next action."""
        ...


def expert_names(env_id: str) -> tuple[str, ...]:
    """The experts of an environment, the default one first; none acts in the Skill environments."""
    kind = family(env_id)
    if kind == "skill":
        return ()
    return (kind,) if kind in SCRIPTS else (*PLANNERS, "scripted")


def expert_keywords(name: str) -> dict[str, Any]:
    """Keyword arguments with which an environment must be made for an expert."""
    return {"control_mode": "ee"} if name in SCRIPTS else {}


def make_expert(env: gym.Env, name: str = "") -> Expert:
    """An expert for an environment.

    Args:
        env: made with `gym.make`.
        name: one of `expert_names`; "" for the first.

    Raises:
        UnknownExpert: no such expert for this environment; the message lists the known ones.
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
    return PlannerExpert(env, PLANNERS[chosen])


class ScriptedExpert:
    """An expert that follows one of `SCRIPTS`.

    Raises:
        UnknownExpert: the environment is not controlled by the velocity of the gripper.
    """

    def __init__(self, env: gym.Env, name: str) -> None:
        base_env: Any = env.unwrapped
        if base_env.config.control_mode != "ee":
            raise UnknownExpert(f"the script {name!r} needs control_mode='ee'")
        self._env, self._name = base_env, name
        self._steps = 0
        self.skill = ""
        self.step_label: StepLabel | None = None
        self.done = False
        self.plan_text = name
        self.report_values: Mapping[str, Any] = {}

    def reset(self) -> None:
        """Start with the episode for which the environment has just been reset."""
        self._steps = 0
        self.done = False

    def act(self) -> NDArray[Any]:
        """The next action."""
        self._steps += 1
        self.done = self._steps >= MAX_SCRIPT_STEPS
        self.skill, action = SCRIPTS[self._name](self._env)
        return action


class PlannerExpert:
    """`planners.TampExpert` without a time limit.

    It gives up after a number of task plans and clearances, so that a loaded machine finds the same plans.
    """

    def __init__(self, env: gym.Env, choice: PlannerChoice) -> None:
        # The scripts do without the planner and its compiled kernels.
        from planners import ExpertConfig, TampExpert

        config = ExpertConfig(planning_s=math.inf)
        self._expert = TampExpert(env, choice.strategy, grasps=choice.grasps, canonical=choice.canonical, config=config)

    @property
    def done(self) -> bool:
        """Whether the planner has finished or given up."""
        return bool(self._expert.done)

    @property
    def skill(self) -> str:
        """The symbolic action and the phase of its motion, such as "PickUp object_03: lift"."""
        return str(self._expert.phase)

    @property
    def step_label(self) -> StepLabel:
        """Phase, contact and keyframe that the last action belongs to."""
        return self._expert.step_label

    @property
    def plan_text(self) -> str:
        """The last plan, as in Fig. 13 of Lee & Kim 2019."""
        return "\n".join(str(action) for action in getattr(self._expert.solution, "actions", ()))

    @property
    def report_values(self) -> Mapping[str, Any]:
        """`EpisodeReport` as JSON values."""
        return dict(json_values(self._expert.report))

    def reset(self) -> None:
        """Plan for the episode for which the environment has just been reset."""
        self._expert.reset()

    def act(self) -> NDArray[Any]:
        """The next action."""
        return np.asarray(self._expert.act())
