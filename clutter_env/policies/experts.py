"""Policies without training: the planner and the scripts, which demonstrate, and rules as a baseline for learned
policies.

They read the simulation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import UnknownExpert
from clutter_env.policies.protocol import PolicyError, PublicInfo
from clutter_env.policies.scripted import SCRIPTS, Step
from clutter_env.reporting.files import json_values
from clutter_env.task import family

if TYPE_CHECKING:
    from planners import StepLabel, TampExpert

_STRATEGIES = ("lookahead", "ngr", "dogar", "srivastava")
"""The strategies of the planner, which takes long to import."""


class PlannerChoice(NamedTuple):
    """A strategy, its grasps, and whether plans are canonical, see `planners.Planner`."""

    strategy: str
    grasps: str = "side"
    canonical: bool = False


_SIDE = {name: PlannerChoice(name) for name in _STRATEGIES} | {"canonical": PlannerChoice("lookahead", canonical=True)}
PLANNERS: Mapping[str, PlannerChoice] = MappingProxyType(
    _SIDE | {f"{name}-all": choice._replace(grasps="all") for name, choice in _SIDE.items()}
)
"""Planning experts by name. Those named "…-all" choose from all grasps, the others from side grasps. "canonical" also
looks ahead, and makes plans that can be learned."""

EXPERTS = (*PLANNERS, *SCRIPTS)
"""Names of all experts."""
MAX_SCRIPT_STEPS = 400
"""Steps after which a script gives up. It needs about a hundred."""


_FRONT_FIRST = (0, 1, 5, 2, 4, 3)
"""Indices of the approach directions, those from the robot's side first."""


def expert_names(env_id: str) -> tuple[str, ...]:
    """Experts of an environment, the default first. The Skill environments have none."""
    kind = family(env_id)
    if kind == "skill":
        return ()
    if kind == "rearrange":  # blocks are taken from above, and trays and other tables are supports
        return tuple(name for name in PLANNERS if name.endswith("-all"))
    return (kind,) if kind in SCRIPTS else (*PLANNERS, "scripted")


def find_expert(env_id: str, name: str = "") -> str:
    """Name of an expert of an environment. "" is the first.

    Raises:
        UnknownExpert: no such expert for this environment. The message lists the known experts.
    """
    known = expert_names(env_id)
    if not known:
        raise UnknownExpert(f"no expert acts in {env_id}; those of the Retrieve environments act in the same scenes")
    if name and name not in known:
        raise UnknownExpert(f"no expert {name!r} for {env_id}; known ones: {', '.join(known)}")
    return name or known[0]


def make_expert(name: str) -> Expert:
    """Make an expert from a name of `find_expert`.

    Raises:
        UnknownExpert: no such expert. The message lists the known experts.
    """
    if name not in EXPERTS:
        raise UnknownExpert(f"no expert {name!r}; known ones: {', '.join(EXPERTS)}")
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
    """`planners.TampExpert` without a time limit, or with one of `planning_s` seconds for each plan.

    It gives up after a number of task plans and clearances, so that a loaded machine finds the same plans.
    """

    is_privileged = True
    env_keywords: Mapping[str, Any] = MappingProxyType({})

    def __init__(self, choice: PlannerChoice, planning_s: float = math.inf) -> None:
        self.grasps, self._choice, self._planning_s = choice.grasps, choice, planning_s
        self._expert: TampExpert | None = None

    def reset(self, info: Mapping[str, Any], env: gym.Env[Any, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Plan for the episode for which the environment has just been reset."""
        # The scripts do without the planner and its compiled kernels.
        from planners import ExpertConfig, TampExpert

        choice, config = self._choice, ExpertConfig(planning_s=self._planning_s)
        self._expert = TampExpert(env, choice.strategy, grasps=choice.grasps, canonical=choice.canonical, config=config)
        self._expert.reset()

    @property
    def done(self) -> bool:
        """Whether the planner has finished or given up."""
        return self._expert is not None and bool(self._expert.done)

    @property
    def failure(self) -> str:
        """Reason for giving up, "" otherwise."""
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


Expert: TypeAlias = ScriptedExpert | PlannerExpert
"""A policy that demonstrates. Your own expert needs the attributes of a privileged policy, and `grasps`, `done` and
`failure`. It labels its last action by `skill`, a name, and `step_label`, a `planners.StepLabel` or None. `plan_text`
and `report_values` (JSON values) are its plan and report."""


class RandomPolicy:
    """Draws actions uniformly. Skills are drawn among those that have not just failed.

    Each episode has its own generator, which depends on the seed and the first observation.
    """

    def __init__(self, seed: int, acts_by_skills: bool = False) -> None:
        self.acts_by_skills = acts_by_skills
        self.grasps = "side" if acts_by_skills else "all"
        self._seed = seed

    def check(self, public: PublicInfo) -> None:
        """Note the space of actions."""
        self._space = public.action_space

    def reset(self, info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode."""
        self._rng: np.random.Generator | None = None

    def act(self, observation: Any) -> Any:
        """A random action."""
        if self._rng is None:
            parts = observation.values() if isinstance(observation, Mapping) else [observation]
            self._rng = np.random.default_rng([self._seed, *b"".join(np.asarray(part).tobytes() for part in parts)])
        if isinstance(self._space, gym.spaces.Box):
            return self._rng.uniform(self._space.low, self._space.high).astype(np.float32)
        from clutter_env.envs.skill import observed_masks  # which imports the planner

        return int(self._rng.choice(np.flatnonzero(observed_masks(observation))))


class GreedyPolicy:
    """Takes the target by skills. While that fails, it clears the nearest object, first those on the robot's side."""

    is_privileged, acts_by_skills, grasps = True, True, "side"

    def reset(self, info: Mapping[str, Any], env: gym.Env[Any, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode.

        Raises:
            PolicyError: the environment has no skills.
        """
        if not isinstance(env.action_space, gym.spaces.Discrete):
            raise PolicyError("the greedy baseline acts by skills; compare it on a Skill or Retrieve environment")
        self._skills: Any = env.unwrapped

    def act(self, observation: Any) -> int:  # noqa: ARG002  it reads the simulation
        """The first skill in this order that has not just failed."""
        masks = self._skills.action_masks(geometric=False)
        if masks[-1]:
            return len(masks) - 1
        directions = len(_FRONT_FIRST)
        wanted = (first + d for first in range(0, len(masks) - 1, directions) for d in _FRONT_FIRST)  # nearest first
        return next(action for action in wanted if masks[action])
