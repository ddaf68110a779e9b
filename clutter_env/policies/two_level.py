"""A policy of two levels: a high-level policy chooses the next pick or place, a motion policy executes it.

A pick-place action (`planners.Contact`) says where the gripper closes around an object or opens to put it down: skill,
object, base pose and TCP pose.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import gymnasium as gym
from numpy.typing import NDArray

from clutter_env.policies.high_level.policy import LearnedHighLevelPolicy
from clutter_env.policies.motion.keyframe_policy import KeyframePolicy
from clutter_env.policies.parsed_observation import Observation
from clutter_env.policies.protocol import SKILLS, PublicInfo
from clutter_env.policies.weights import shipped_path
from planners import Contact, find_grasp_set

_HOLD_STEPS = 20
"""Control steps with the target in the gripper before the policy has finished: twice the time required for success."""


class HighLevelPolicy(Protocol):
    """Chooses picks and places, one at a time. Like a policy it may be privileged and have `check`.

    Attributes:
        failure: reason for giving up, "" otherwise.
    """

    failure: str

    @property
    def reset(self) -> Callable[..., None]:
        """Start an episode: `reset(info)`, or `reset(info, env)` of a privileged one."""

    def decide(self, observation: Observation) -> Contact | None:
        """Choose the next pick or place, after the last has been executed or has failed. None to give up."""


class MotionPolicy(Protocol):
    """Executes picks and places, one at a time. Like a policy it may be privileged and have `check`.

    Attributes:
        is_done: the motion has ended, and the next may be started.
        has_failed: it has ended without the object in the gripper. For a place: with the object still in it.
    """

    is_done: bool
    has_failed: bool

    @property
    def reset(self) -> Callable[..., None]:
        """Start an episode: `reset(info)`, or `reset(info, env)` of a privileged one."""

    def start(self, contact: Contact, observation: Observation) -> None:
        """Begin to execute a pick or a place."""

    def act(self, observation: Observation) -> NDArray[Any]:
        """The next action. After the motion has ended, the robot stays still."""


class TwoLevelPolicy:
    """Asks the high-level policy for a pick or a place, lets the motion policy execute it, and asks again.

    It has finished after the target has been taken, and has given up when the high-level policy does, or after 20 picks
    or 20 places, failed ones included: the budget of all policies that act by skills.

    Attributes:
        is_privileged: one of the levels reads the simulation.
        grasps: "side" or "all" (other sets): the grasps that the high-level policy chooses from.
        failure: why it gave up, "" if it did not.
        started, failed: how many picks and places were started and failed in this episode.
    """

    failure = ""

    def __init__(self, high_level: HighLevelPolicy, motion: MotionPolicy, grasps: str = "side") -> None:
        self.grasps = "side" if grasps == "side" else "all"
        find_grasp_set(grasps)  # raises for one that there is not, before an episode is played
        self._high_level, self._motion = high_level, motion
        self.is_privileged = any(getattr(level, "is_privileged", False) for level in (high_level, motion))

    def check(self, public: PublicInfo) -> None:
        """Refuse an environment with another robot or layout than the weights of either level (`PolicyError`)."""
        for level in (self._high_level, self._motion):
            if hasattr(level, "check"):
                level.check(public)

    def reset(self, info: Mapping[str, Any], env: gym.Env[Any, Any] | None = None) -> None:
        """Start an episode of both levels. Only privileged levels receive `env`."""
        self._target, self.failure = str(info["target"]), ""
        self._contact: Contact | None = None
        self._is_taken, self._steps_after, self.started, self.failed = False, 0, 0, 0
        self._tries = Counter[str]()
        for level in (self._high_level, self._motion):
            arguments = (info, env) if getattr(level, "is_privileged", False) else (info,)
            level.reset(*arguments)

    @property
    def done(self) -> bool:
        """Whether it has finished or given up."""
        return bool(self.failure) or self._steps_after > _HOLD_STEPS

    @property
    def phase(self) -> str:
        """The pick or place that is executed and the phase of its motion, such as "pick object_03: lift"."""
        if self._contact is None:
            return ""
        return f"{self._contact.skill} {self._contact.object}: {getattr(self._motion, 'phase', '')}"

    def act(self, observation: Observation) -> NDArray[Any]:
        """The next action."""
        if self._contact is not None and self._motion.is_done:
            self.failed += self._motion.has_failed
            takes = self._contact.skill == "pick" and self._contact.object == self._target
            self._is_taken = takes and not self._motion.has_failed
            self._contact = None
        if self._contact is None and not self._is_taken and not self.failure:
            self._start_next(observation)
        self._steps_after += self._is_taken
        return self._motion.act(observation)

    def _start_next(self, observation: Observation) -> None:
        contact = self._high_level.decide(observation)
        if contact is None:
            self.failure = self._high_level.failure or "the high-level policy gave up"
            return
        if self._tries[contact.skill] == SKILLS:  # failed ones included
            self.failure = f"the target was not taken with {SKILLS} picks and places"
            return
        self._contact = contact
        self._tries[contact.skill] += 1
        self.started += 1
        self._motion.start(contact, observation)


def shipped_policy(problem: str) -> TwoLevelPolicy:
    """The policy with the weights of the package for a problem, one of `weights.PROBLEMS`."""
    decisions = LearnedHighLevelPolicy.load(shipped_path("decisions", problem))
    return TwoLevelPolicy(decisions, KeyframePolicy.load(shipped_path("motions", problem)), decisions.info.grasps)
