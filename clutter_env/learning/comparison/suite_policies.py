"""Policies that play scenes, by name: the built-in ones, training runs, and those of other people by import name."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium as gym

from clutter_env.learning.comparison.evaluation import SuitePolicy, begin_episode
from clutter_env.learning.comparison.run_names import run_directories
from clutter_env.learning.demonstrations.experts import (
    PLANNERS,
    Expert,
    PlannerChoice,
    PlannerExpert,
    ScriptedExpert,
    expert_keywords,
)
from clutter_env.learning.demonstrations.scripted import SCRIPTS
from clutter_env.learning.errors import LearningError
from clutter_env.learning.policies.baselines import Bulldozer, greedy_agent, random_agent
from clutter_env.learning.policies.runs import DECISION_LEARNERS, MOVER_LEARNERS, load_run
from clutter_env.learning.task import family
from clutter_env.suites import GRASPS

__all__ = ["BUILT_IN", "acts_by_skills", "env_keywords", "load_policy", "policy_families", "policy_grasps"]

_FREE_KEYWORDS = ("control_mode", "obs_mode", "image_size", "reward_mode")
"""Keyword arguments of the environment that a policy may choose: they change neither the scenes nor the success."""


class ExpertPolicy:
    """An expert, which reads the exact state of the simulation.

    Attributes:
        grasps: the grasps that it chooses from, "side" or "all"; with "all" the planner also puts objects on every
            support.
        env_keywords: keyword arguments with which an environment must be made for it.
    """

    def __init__(
        self, make: Callable[[gym.Env[Any, Any]], Expert], grasps: str, env_keywords: Mapping[str, Any]
    ) -> None:
        self.grasps, self.env_keywords = grasps, env_keywords
        self._make = make
        self._expert: Expert | None = None

    def reset(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode."""
        self._expert = self._make(env)
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


class AgentPolicy:
    """A function from observations to actions that is made anew for every episode.

    Attributes:
        acts_by_skills: whether it plays the Skill environment of the scenes.
        grasps: those of the skills are level ones.
        env_keywords: keyword arguments with which an environment must be made for it.
    """

    def __init__(
        self,
        make: Callable[[gym.Env[Any, Any]], Callable[[Any], Any]],
        acts_by_skills: bool = False,
        env_keywords: Mapping[str, Any] = MappingProxyType({}),
    ) -> None:
        self.acts_by_skills, self.env_keywords = acts_by_skills, env_keywords
        self.grasps = "side" if acts_by_skills else "all"
        self._make = make
        self._act: Callable[[Any], Any] | None = None

    def reset(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode."""
        self._act = self._make(env)

    def act(self, observation: Any) -> Any:
        """The next action."""
        assert self._act is not None
        return self._act(observation)


def _random_policy(acts_by_skills: bool, seed: int) -> SuitePolicy:
    """Actions drawn uniformly, in each episode from a generator of its own."""

    def make(env: gym.Env[Any, Any]) -> Callable[[Any], Any]:
        """For the episode that has just begun."""
        return random_agent(env, seed + env.unwrapped.np_random_seed)

    return AgentPolicy(make, acts_by_skills)


def _planner_policy(choice: PlannerChoice) -> SuitePolicy:
    return ExpertPolicy(partial(PlannerExpert, choice=choice), choice.grasps, {})


def _script_policy(name: str) -> SuitePolicy:
    return ExpertPolicy(partial(ScriptedExpert, name=name), "all", expert_keywords(name))


def _run_policy(directories: Sequence[Path]) -> SuitePolicy:
    """The policy of a training run, loaded once, for the first episode's environment; or of two runs."""
    directory, *others = directories
    if others or load_run(directory)["algorithm"] in (*DECISION_LEARNERS, *MOVER_LEARNERS):
        from clutter_env.learning.comparison.run_policies import two_level_policy  # needs torch, as below

        return two_level_policy(directories)
    task = load_run(directory)["task"]
    loaded: dict[int, Callable[[Any], Any]] = {}

    def make(env: gym.Env[Any, Any]) -> Callable[[Any], Any]:
        """The same policy for every episode in one environment."""
        from clutter_env.learning.policies.agents import load_agent  # needs torch, which the other policies do without

        if id(env) not in loaded:
            loaded.clear()
            loaded[id(env)] = load_agent(directory, env)
        begin_episode(loaded[id(env)])
        return loaded[id(env)]

    is_of_skills = family(task["env_id"]) == "skill"
    wanted = {} if is_of_skills else {key: task["keywords"][key] for key in _FREE_KEYWORDS if key in task["keywords"]}
    return AgentPolicy(make, is_of_skills, wanted)


_FIXED: Mapping[str, Callable[[], SuitePolicy]] = MappingProxyType(
    {name: partial(_planner_policy, choice) for name, choice in PLANNERS.items()}
    | {name: partial(_script_policy, name) for name in SCRIPTS}
    | {"greedy": partial(AgentPolicy, greedy_agent, acts_by_skills=True), "bulldozer": Bulldozer}
)
"""The built-in policies without a random seed."""
_RANDOM = {"random": False, "random-skills": True}
"""The built-in policies with a random seed: whether they act by skills."""
_GOAL_FAMILIES = ("reach", "pick")
_LEARNED = {
    "keyframes": "clutter_env.learning.comparison.learned_policies:keyframes",
    "keyframes-all": "clutter_env.learning.comparison.learned_policies:keyframes_all",
    "keyframes-shelf": "clutter_env.learning.comparison.learned_policies:keyframes_shelf",
    "planned-decisions": "clutter_env.learning.comparison.learned_policies:planned_decisions",
    "planned-decisions-all": "clutter_env.learning.comparison.learned_policies:planned_decisions_all",
    "planned-decisions-shelf": "clutter_env.learning.comparison.learned_policies:planned_decisions_shelf",
    "planned-motions": "clutter_env.learning.comparison.decision_policies:side",
    "planned-motions-all": "clutter_env.learning.comparison.decision_policies:all_grasps",
    "planned-motions-shelf": "clutter_env.learning.comparison.decision_policies:shelf",
}
"""Where the trained policies are, which need torch: learned decisions and motions, the expert's decisions and learned
motions, learned decisions and the planner's motions; with level grasps, all grasps, and under the shelf's board."""
BUILT_IN = (*_FIXED, *_LEARNED, *_RANDOM)
"""Names of the built-in policies."""


def load_policy(name: str, seed: int) -> SuitePolicy:
    """A policy by its name.

    Args:
        name: one of `BUILT_IN`; the directory of a training run, or those of learned decisions and learned motions with
            a "+" between; or "module:Class" of a class without arguments; modules are also looked for in the current
            directory.
        seed: of the built-in random policies.

    Raises:
        LearningError: there is no such policy, or it lacks the methods of the protocol.
    """
    if name in _FIXED:
        return _FIXED[name]()
    if name in _RANDOM:
        return _random_policy(_RANDOM[name], seed)
    if runs := run_directories(name):
        return _run_policy(runs)
    module, _, attribute = _LEARNED.get(name, name).partition(":")
    if not attribute:
        raise LearningError(
            f"no policy {name!r}; give module:Class, the directory of a training run, or one of {', '.join(BUILT_IN)}"
        )
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


def acts_by_skills(policy: SuitePolicy) -> bool:
    """Whether the policy plays the Skill environment of the scenes."""
    return bool(getattr(policy, "acts_by_skills", False))


def policy_families(name: str) -> tuple[str, ...]:
    """The families of environments whose scenes a policy can play; of other people's policies all."""
    every = ("retrieve", *_GOAL_FAMILIES)
    if name in _GOAL_FAMILIES:
        return (name,)
    if runs := run_directories(name):
        own = family(load_run(runs[0])["task"]["env_id"])
        return ("retrieve" if own == "skill" else own,)
    return ("retrieve",) if name in BUILT_IN and name != "random" else every
