"""Policies that play suites: the protocol, the built-in ones, and those of other people by their import name."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import gymnasium as gym

from clutter_env.learning.demonstrations.experts import PLANNERS, Expert, PlannerChoice, PlannerExpert
from clutter_env.learning.errors import LearningError
from clutter_env.learning.policies.baselines import Bulldozer, random_agent
from clutter_env.suites import GRASPS

__all__ = ["BUILT_IN", "SuitePolicy", "env_keywords", "load_policy", "policy_grasps"]

_FREE_KEYWORDS = ("control_mode", "obs_mode", "image_size", "reward_mode")
"""Keyword arguments of the environment that a policy may choose: they change neither the scenes nor the success."""


class SuitePolicy(Protocol):
    """What plays a suite. What it does in an episode must not depend on earlier episodes.

    Optional attributes: `env_keywords`, a dictionary of keyword arguments of the environment among control_mode,
    obs_mode, image_size and reward_mode; `grasps`, "side" or "all" (the default): the grasps that it uses, by whose
    floors its results are broken down; `done`, true once the policy gives up; `failure`, then the reason.
    """

    def reset(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> None:
        """Start an episode; `env` has been reset and returned `info`."""
        ...

    def act(self, observation: Any) -> Any:
        """The next action."""
        ...


class ExpertPolicy:
    """The task and motion planning expert, which reads the exact state of the simulation.

    Attributes:
        grasps: the grasps that it chooses from, "side" or "all"; with "all" it also puts objects on every support.
    """

    def __init__(self, choice: PlannerChoice) -> None:
        self.grasps = choice.grasps
        self._choice = choice
        self._expert: Expert | None = None

    def reset(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode."""
        self._expert = PlannerExpert(env, self._choice)
        self._expert.reset()

    @property
    def done(self) -> bool:
        """Whether it has finished or given up."""
        return self._expert is not None and self._expert.done

    @property
    def failure(self) -> str:
        """Why it gave up, "" if it did not say."""
        return "" if self._expert is None else str(self._expert.report_values.get("failure") or "")

    def act(self, observation: Any) -> Any:  # noqa: ARG002  the expert reads the simulation
        """The next action."""
        assert self._expert is not None
        return self._expert.act()


class RandomPolicy:
    """Actions drawn uniformly, in each episode from a generator of its own."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._act: Callable[[Any], Any] | None = None

    def reset(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode."""
        scene_seed = env.unwrapped.np_random_seed
        self._act = random_agent(env, self._seed + scene_seed)

    def act(self, observation: Any) -> Any:
        """A random action."""
        assert self._act is not None
        return self._act(observation)


BUILT_IN = (*PLANNERS, "random", "bulldozer")
"""Names of the built-in policies; the experts "…-all" choose from all grasps, the others from side grasps."""


def load_policy(name: str, seed: int) -> SuitePolicy:
    """A policy by its name.

    Args:
        name: one of `BUILT_IN`, or "module:Class" of a class without arguments; modules are also looked for in the
            current directory.
        seed: of the built-in random policy.

    Raises:
        LearningError: there is no such policy, or it lacks the methods of the protocol.
    """
    if name in PLANNERS:
        return ExpertPolicy(PLANNERS[name])
    if name == "random":
        return RandomPolicy(seed)
    if name == "bulldozer":
        return Bulldozer()
    module, _, attribute = name.partition(":")
    if not attribute:
        raise LearningError(f"no policy {name!r}; give module:Class, or one of {', '.join(BUILT_IN)}")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        made: SuitePolicy = getattr(importlib.import_module(module), attribute)()
    except (ImportError, AttributeError) as problem:
        raise LearningError(f"policy {name!r} cannot be imported: {problem}") from problem
    for method in ("reset", "act"):
        if not callable(getattr(made, method, None)):
            raise LearningError(f"policy {name!r} has no method {method!r}; a policy has reset(env, info) and act(obs)")
    return made


def env_keywords(policy: SuitePolicy) -> dict[str, Any]:
    """The keyword arguments with which the policy wants the environment.

    Raises:
        LearningError: one that would change the scenes or the success; the message lists the valid ones.
    """
    wanted = dict(getattr(policy, "env_keywords", {}))
    for name in wanted:
        if name not in _FREE_KEYWORDS:
            raise LearningError(f"a policy may not choose {name!r}; it may choose {', '.join(_FREE_KEYWORDS)}")
    return wanted


def policy_grasps(policy: SuitePolicy) -> str:
    """The grasp set by whose floors the results of a policy are broken down.

    Raises:
        LearningError: one for which the suites have no floors; the message lists the valid ones.
    """
    grasps = getattr(policy, "grasps", "all")
    if grasps not in GRASPS:
        raise LearningError(f"a policy's grasps={grasps!r} are not valid; it may have {', '.join(GRASPS)}")
    return str(grasps)
