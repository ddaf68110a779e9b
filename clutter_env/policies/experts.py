"""Experts: privileged policies that demonstrate, the task and motion planner and the scripts."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import UnknownExpert
from clutter_env.policies.protocol import PolicyError
from clutter_env.policies.scripted import SCRIPTS, Step
from clutter_env.reporting.files import json_values
from clutter_env.task import family

if TYPE_CHECKING:
    from planners import StepLabel, TampExpert

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
    """A privileged policy that can say what it does.

    Attributes:
        grasps: the grasps that it chooses from, "side" or "all"; with "all" the planner also puts objects on every
            support.
        env_keywords: keyword arguments with which an environment must be made for it.
    """

    is_privileged: bool
    grasps: str
    env_keywords: Mapping[str, Any]

    def reset(self, info: Mapping[str, Any], env: gym.Env[Any, Any]) -> None:
        """Start an episode; `env` has been reset and returned `info`."""

    def act(self, observation: Any) -> NDArray[Any]:
        """The next action."""

    @property
    def done(self) -> bool:
        """Whether it has finished or given up."""

    @property
    def failure(self) -> str:
        """Why it gave up, "" if it did not say."""

    @property
    def skill(self) -> str:
        """Name of the skill that the last action belongs to."""

    @property
    def step_label(self) -> StepLabel | None:
        """Phase, contact and keyframe that the last action belongs to; None if it has no plan."""

    @property
    def plan_text(self) -> str:
        """The plan, one action per line."""

    @property
    def report_values(self) -> Mapping[str, Any]:
        """The report as JSON values."""


def expert_names(env_id: str) -> tuple[str, ...]:
    """The experts of an environment, the default one first; none acts in the Skill environments."""
    kind = family(env_id)
    if kind == "skill":
        return ()
    return (kind,) if kind in SCRIPTS else (*PLANNERS, "scripted")


def find_expert(env_id: str, name: str = "") -> str:
    """The name of an expert of an environment; "" stands for the first.

    Raises:
        UnknownExpert: no such expert for this environment; the message lists the known ones.
    """
    known = expert_names(env_id)
    if not known:
        raise UnknownExpert(f"no expert acts in {env_id}; those of the Retrieve environments act in the same scenes")
    if name and name not in known:
        raise UnknownExpert(f"no expert {name!r} for {env_id}; known ones: {', '.join(known)}")
    return name or known[0]


def make_expert(name: str) -> Expert:
    """An expert by a name of `find_expert`."""
    return ScriptedExpert(name, SCRIPTS[name]) if name in SCRIPTS else PlannerExpert(PLANNERS[name])


class ScriptedExpert:
    """Follows a script in an environment with `control_mode="ee"`.

    Attributes:
        grasps: "side" for a script that holds the gripper level.
    """

    is_privileged, failure = True, ""
    env_keywords: Mapping[str, Any] = MappingProxyType({"control_mode": "ee"})

    def __init__(self, name: str, script: Callable[[Any], Step], grasps: str = "all") -> None:
        self.grasps, self._name, self._script, self._steps = grasps, name, script, 0
        self.skill, self.plan_text = "", name
        self.step_label: StepLabel | None = None
        self.report_values: Mapping[str, Any] = {}

    def reset(self, info: Mapping[str, Any], env: gym.Env[Any, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode.

        Raises:
            PolicyError: the environment is not controlled by the velocity of the gripper.
        """
        inner: Any = env.unwrapped
        if inner.config.control_mode != "ee":
            raise PolicyError(f"the script {self._name!r} needs control_mode='ee'")
        self._env, self._steps = inner, 0

    @property
    def done(self) -> bool:
        """Whether it has given up."""
        return self._steps >= MAX_SCRIPT_STEPS

    def act(self, observation: Any) -> NDArray[Any]:  # noqa: ARG002  it reads the simulation
        """The next action."""
        self._steps += 1
        self.skill, action = self._script(self._env)
        return action


class PlannerExpert:
    """`planners.TampExpert` without a time limit.

    It gives up after a number of task plans and clearances, so that a loaded machine finds the same plans.
    """

    is_privileged = True
    env_keywords: Mapping[str, Any] = MappingProxyType({})

    def __init__(self, choice: PlannerChoice) -> None:
        self.grasps, self._choice = choice.grasps, choice
        self._expert: TampExpert | None = None

    def reset(self, info: Mapping[str, Any], env: gym.Env[Any, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Plan for the episode for which the environment has just been reset."""
        # The scripts do without the planner and its compiled kernels.
        from planners import ExpertConfig, TampExpert

        choice, config = self._choice, ExpertConfig(planning_s=math.inf)
        self._expert = TampExpert(env, choice.strategy, grasps=choice.grasps, canonical=choice.canonical, config=config)
        self._expert.reset()

    @property
    def done(self) -> bool:
        """Whether the planner has finished or given up."""
        return self._expert is not None and bool(self._expert.done)

    @property
    def failure(self) -> str:
        """Why it gave up, "" if it did not."""
        return str(self.report_values.get("failure") or "")

    @property
    def skill(self) -> str:
        """The symbolic action and the phase of its motion, such as "PickUp object_03: lift"."""
        return "" if self._expert is None else str(self._expert.phase)

    @property
    def step_label(self) -> StepLabel | None:
        """Phase, contact and keyframe that the last action belongs to."""
        return None if self._expert is None else self._expert.step_label

    @property
    def plan_text(self) -> str:
        """The last plan, as in Fig. 13 of Lee & Kim 2019."""
        solution = None if self._expert is None else self._expert.solution
        return "\n".join(str(action) for action in getattr(solution, "actions", ()))

    @property
    def report_values(self) -> Mapping[str, Any]:
        """`EpisodeReport` as JSON values."""
        return {} if self._expert is None else dict(json_values(self._expert.report))

    def act(self, observation: Any) -> NDArray[Any]:  # noqa: ARG002  it reads the simulation
        """The next action."""
        assert self._expert is not None
        return np.asarray(self._expert.act())
