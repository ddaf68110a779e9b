"""Goals of episodes as English sentences: in the observation, and in the info.

`gym.make(..., instruction=True)` makes any environment of the package so. Here are the entry points of all ids.

`planners.goals.Goal.sentence` writes goals that have facts, and `goals.from_sentence` reads them again. Templates write
the others: points that a gripper or an object must reach.
"""

from __future__ import annotations

import copyreg
import string
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any, ClassVar

import gymnasium as gym
from gymnasium import spaces

from clutter_env.config import CONTROL_HZ, RENDER_MODES
from clutter_env.errors import OptionError, check_choice

NAME = "instruction"
"""Of the entry in observation and info, and of the keyword argument."""
LONGEST = 8192
"""Characters of a sentence at most: a goal for each of 60 objects."""
SIGNS = string.ascii_letters + string.digits + string.punctuation + " °"
"""Characters of sentences."""
_VECTOR = "observation"
"""The entry with what is observed, where an environment has a single vector."""


class Instructed(gym.Env[Any, Any]):
    """Mixin of an environment with instructions."""

    def __init__(self, **keywords: Any) -> None:
        super().__init__(**keywords)  # that of the environment, which follows in the order of the bases
        self._sentence = ""
        text = spaces.Text(LONGEST, min_length=1, charset=SIGNS)
        self.observation_space = spaces.Dict({**self._entries(self.observation_space), NAME: text})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment. The sentence is that of the new episode.

        Raises:
            OptionError: also for a goal whose sentence is longer than `LONGEST`, or has other characters than `SIGNS`.
        """
        observation, info = super().reset(seed=seed, options=options)
        self._sentence = sentence(self)
        return self._told(observation), {**info, NAME: self._sentence}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """As of the environment itself."""
        observation, reward, terminated, truncated, info = super().step(action)
        return self._told(observation), reward, terminated, truncated, {**info, NAME: self._sentence}

    def restore_state(self, state: bytes) -> None:
        """Restore the environment. The sentence is that of the saved episode."""
        super().restore_state(state)  # type: ignore[misc]  # that of the environment
        self._sentence = sentence(self)

    def _told(self, observation: Any) -> dict[str, Any]:
        return {**self._entries(observation), NAME: self._sentence}

    @staticmethod
    def _entries(observed: Any) -> dict[str, Any]:
        if isinstance(observed, spaces.Dict):
            return dict(observed.spaces)
        return observed if isinstance(observed, dict) else {_VECTOR: observed}

    def __reduce_ex__(self, protocol: Any) -> Any:
        reduced: Any = super().__reduce_ex__(protocol)
        made, arguments, *rest = reduced
        kind = type(self).__bases__[1]
        if made is getattr(copyreg, "__newobj__"):  # noqa: B009  its name would be mangled
            return partial(_unmade, kind), (), *rest
        return made, tuple(partial(_make, kind) if one is type(self) else one for one in arguments), *rest


def sentence(env: gym.Env[Any, Any]) -> str:
    """The goal of the present episode of an environment, in English.

    Raises:
        OptionError: there are no words for the goal, see `Instructed.reset`.
    """
    outer: Any = env.unwrapped
    said = _said(getattr(outer, "physics_env", outer))  # Skill contains one
    if len(said) > LONGEST or not set(said) <= set(SIGNS):
        raise OptionError(f"the goal's sentence has more than {LONGEST} characters, or other ones: {said:.80}")
    return said


def _said(env: Any) -> str:
    from clutter_env.envs.goal import GoalEnv
    from planners.goals import Goal, holding

    if isinstance(env, GoalEnv):
        point = ", ".join(f"{number:.3f}" for number in env.goal)
        what = f"Bring the {env.target.replace('_', ' ')}" if env.target else "Move the gripper"
        return f"{what} to ({point}) m."
    goal = getattr(env, "goal", None)
    return goal.sentence() if isinstance(goal, Goal) else holding(env.target).sentence()


_CLASSES: dict[type[gym.Env[Any, Any]], Any] = {}
"""Classes that were made, so that environments of one kind are of one class."""


def _instructed(kind: type[gym.Env[Any, Any]]) -> Any:
    """The class of environments of a kind with instructions. It has the kind's name, and so shares its saved states."""
    if kind not in _CLASSES:
        _CLASSES[kind] = type(kind.__name__, (Instructed, kind), {"__doc__": kind.__doc__})
    return _CLASSES[kind]


def _make(kind: type[gym.Env[Any, Any]], **keywords: Any) -> gym.Env[Any, Any]:
    made: gym.Env[Any, Any] = _instructed(kind)(**keywords)
    return made


def _unmade(kind: type[gym.Env[Any, Any]]) -> gym.Env[Any, Any]:
    """An environment whose attributes are still to be set, by the reader of a pickle."""
    cls = _instructed(kind)
    empty: gym.Env[Any, Any] = cls.__new__(cls)
    return empty


@dataclass(frozen=True)
class EntryPoint:
    """Entry point of Gymnasium for an id. The environment's module is imported when one is made.

    Attributes:
        module: of `clutter_env.envs`.
        name: of the class in it.
    """

    module: str
    name: str
    metadata: ClassVar[dict[str, Any]] = {"render_modes": list(RENDER_MODES), "render_fps": CONTROL_HZ}
    """That of all environments, in which Gymnasium looks before it makes one."""

    def __call__(self, instruction: bool = False, **keywords: Any) -> gym.Env[Any, Any]:
        """Make the environment.

        Args:
            instruction: whether observation and info say in English what is to be done.
            keywords: of the environment.

        Raises:
            ConfigError: see the environment.
        """
        check_choice(NAME, instruction, (False, True))
        kind = self._kind(keywords)
        return _make(kind, **keywords) if instruction else kind(**keywords)

    def _kind(self, keywords: dict[str, Any]) -> type[gym.Env[Any, Any]]:  # noqa: ARG002  of the Retrieve ids
        """The class for these keyword arguments, of which it takes what only decides the class."""
        kind: type[gym.Env[Any, Any]] = getattr(import_module(f"clutter_env.envs.{self.module}"), self.name)
        return kind


class _Retrieve(EntryPoint):
    """That of the Retrieve ids, where `object_order` decides between two classes."""

    def _kind(self, keywords: dict[str, Any]) -> type[gym.Env[Any, Any]]:
        from clutter_env.envs.relevance import OBJECT_ORDERS, RelevantRetrieveEnv

        order = keywords.pop("object_order", "slots")
        check_choice("object_order", order, OBJECT_ORDERS)
        return super()._kind(keywords) if order == "slots" else RelevantRetrieveEnv


retrieve = _Retrieve("retrieve", "RetrieveEnv")
reach = EntryPoint("goal", "ReachEnv")
pick = EntryPoint("goal", "PickEnv")
arm_reach = EntryPoint("arm", "ArmReachEnv")
arm_pick = EntryPoint("arm", "ArmPickEnv")
open_ = EntryPoint("opening", "OpenEnv")
rearrange = EntryPoint("rearrange", "RearrangeEnv")
search = EntryPoint("search", "SearchEnv")
arm_retrieve = EntryPoint("arm_retrieve", "ArmRetrieveEnv")
skill = EntryPoint("skill", "SkillEnv")
