"""A person as a policy: moves of single objects, which the planner executes, and recorded ones to play again.

A move takes one object, or puts the held one down. The planner finds its motions, but moves nothing else out of the
way: what has to go first is for the person to decide.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.policies.protocol import PolicyError, PublicInfo

if TYPE_CHECKING:
    from planners import Goal, Scene, Solution, StepLabel, TampExpert
    from planners.expert.report import Recording

_REST = 4
"""Control steps of rest between two moves: the next one begins at the measured joint angles."""
_SETTLE = 20
"""Control steps of rest after a motion that did not go as planned."""
_STAND_OFF = 0.002
"""[m] Gap of two objects below which they count as touching."""


@dataclass(frozen=True)
class Take:
    """Move that takes an object.

    Attributes:
        object: name of the object.
    """

    object: str


@dataclass(frozen=True)
class Put:
    """Move that puts the held object down.

    Attributes:
        x, y: position [m] of the object's centre.
        z: height [m] of the face that it is put on.
    """

    x: float
    y: float
    z: float


Move: TypeAlias = Take | Put


@dataclass(frozen=True)
class Step:
    """One control step of a person's episode.

    Attributes:
        action: the action.
        skill: action and phase of the motion, "" for none.
        label: label for imitation learning.
    """

    action: NDArray[np.float64]
    skill: str
    label: StepLabel | None


@dataclass
class ByHand:
    """A policy whose moves somebody else decides.

    Attributes:
        ask: returns the next move, or None to give up. It is called when a move is over, and after a refusal.
        answer: called with a move and the sentence by which it is refused, "" if it is made.
        grasps: the grasp set to choose from: "side" or "all".
        moves: number of objects other than the target that were taken.
        held: name of the object in the gripper, "" for none.
        happened: how the last motion deviated from its plan, "" if it did not.
        steps: the steps of the episode.
    """

    ask: Callable[[], Move | None]
    answer: Callable[[Move, str], object] = lambda *_: None
    grasps: str = "side"
    moves: int = field(default=0, init=False)
    held: str = field(default="", init=False)
    happened: str = field(default="", init=False)
    steps: list[Step] = field(default_factory=list, init=False)
    done: bool = field(default=False, init=False)

    is_privileged, is_human, failure = True, True, "gave up"
    env_keywords: ClassVar[Mapping[str, Any]] = MappingProxyType({"control_mode": "joint"})

    def check(self, public: PublicInfo) -> None:
        """Raise `PolicyError` for environments other than Retrieve."""
        if public.family != "retrieve":
            raise PolicyError(f"a person plays the Retrieve environments, not {public.family}")

    def reset(self, info: Mapping[str, Any], env: gym.Env[Any, Any]) -> None:
        """Start an episode in an environment that has been reset."""
        from planners import ExpertConfig, Planner, TampExpert
        from planners.expert.report import Recorder
        from planners.expert.world import PerceivedWorld

        inner: Any = env.unwrapped
        self._env, self._target = inner, str(info["target"])
        planner = Planner(inner.robot, grasps=self.grasps)
        config = ExpertConfig(replans=0, with_floor=False)
        self._expert: TampExpert = TampExpert(env, planner=planner, config=config)
        self._world, self._recorder = PerceivedWorld(inner), Recorder(inner, self._target)
        self._is_moving, self._rest = False, 0
        self.moves, self.held, self.happened, self.steps, self.done = 0, "", "", [], False

    @property
    def recording(self) -> Recording:
        """States and moves so far, for a page in a browser."""
        return self._recorder.recording()

    @property
    def phase(self) -> str:
        """Action and phase of the motion, "" between moves."""
        return self._expert.phase if self._is_moving else ""

    def act(self, observation: Any) -> NDArray[Any]:  # noqa: ARG002  it reads the simulation
        """The next action of a motion. Between motions the simulation waits for the next move."""
        while not self._is_moving and not self._rest and not self.done:
            self._decide()
        self._recorder.add_frame(*((self._expert.action, self._expert.phase) if self._is_moving else ()))
        if self.done:  # given up: one more step at rest, since the loop over an episode wants an action
            last = Step(np.zeros(self._env.action_size), "", None)
            self.steps.append(self.steps[-1] if self.steps else last)
            return self.steps[-1].action
        action = np.asarray(self._expert.act())
        self.steps.append(Step(action, self._expert.phase, self._expert.step_label))
        if not self._is_moving:
            self._rest = max(self._rest - 1, 0)
        elif self._expert.done:
            self._end_motion()
        return action

    def _decide(self) -> None:
        """Ask for a move, and begin it or refuse it."""
        move = self.ask()
        if move is None:
            self.done = True
            return
        refusal = self._begin(move)
        if not refusal:
            self._is_moving, self.happened = True, ""
            self.moves += isinstance(move, Take) and move.object != self._target
        self.answer(move, refusal)

    def _end_motion(self) -> None:
        """Rest before the next move, and note the held object and errors."""
        from planners import SceneError

        failure = self._expert.report.failure
        self._is_moving, self._rest, self.happened = False, _SETTLE if failure else _REST, failure
        try:
            held = self._world.scene().held
        except SceneError as error:
            self.happened, held = str(error), None
        self.held = "" if held is None else held.name

    def _begin(self, move: Move) -> str:
        """Plan a move. Return why it is refused, in one sentence, or "" if it can begin."""
        from planners import GoalError, Infeasible, SceneError, find_grasp_set
        from planners.expert.config import ExpertError

        try:
            scene = self._world.scene()
            refusal, goal = _take(scene, move, self.grasps) if isinstance(move, Take) else _put(scene, move)
            if goal is None:
                return refusal
            self._expert.reset(goal)
        except (GoalError, SceneError, ExpertError) as error:
            return f"Not possible: {error}."
        own = move.object if isinstance(move, Take) else self.held
        found = self._expert.solution
        if found is None:
            return f"Not possible: {self._expert.report.failure}."
        if isinstance(found, Infeasible):
            return f"Not possible: {found.cause}, {found.detail}."
        if others := _moved_besides(found, own):
            return f"No motion does that without moving {listed(others)} first."
        self._recorder.add_solve(found, scene, find_grasp_set(self.grasps))
        return ""


@dataclass
class Human:
    """Episodes that a person has played, as a policy that plays them again, in their order.

    Attributes:
        episodes: the steps of each episode.
        grasps: the grasp set that the person chose from.
    """

    episodes: Sequence[Sequence[Step]]
    grasps: str = "side"

    is_privileged, is_human, failure, plan_text = True, True, "gave up", ""
    env_keywords: ClassVar[Mapping[str, Any]] = MappingProxyType({"control_mode": "joint"})
    _next: int = field(default=0, init=False)

    def reset(self, info: Mapping[str, Any], env: gym.Env[Any, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start the next episode."""
        self._steps, self._at = self.episodes[self._next % len(self.episodes)], 0
        self._next += 1

    @property
    def done(self) -> bool:
        """Whether all steps of the episode have been played."""
        return self._at >= len(self._steps)

    @property
    def _last(self) -> Step:
        return self._steps[max(self._at - 1, 0)]

    @property
    def skill(self) -> str:
        """Action and phase of the motion of the last action."""
        return self._last.skill

    @property
    def step_label(self) -> StepLabel | None:
        """Label of the last action."""
        return self._last.label

    @property
    def report_values(self) -> Mapping[str, Any]:
        """Name of the player."""
        return {"played_by": "a person"}

    def act(self, observation: Any) -> NDArray[Any]:  # noqa: ARG002  part of the protocol
        """The next recorded action."""
        self._at += 1
        return self._last.action


def listed(names: Sequence[str]) -> str:
    """Names in words: "a, b and c"."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def _take(scene: Scene, move: Take, grasps: str) -> tuple[str, Goal | None]:
    """Refusal of a move that takes an object, or its goal."""
    from planners import find_grasp_set
    from planners.drawing.why import why_grasps
    from planners.goals import holding

    name = move.object
    if name not in scene.names:
        return f"There is no object {name!r}.", None
    if scene.held is not None:
        return f"The hand is full: put {scene.held.name} down first.", None
    (answer,) = why_grasps(scene, find_grasp_set(grasps), names=(name,))
    if any(way.moves == 0 for way in answer.ways):
        return "", holding(name)
    possible = [way for way in answer.ways if way.moves is not None]
    if possible:
        names = possible[0].blockers
        be = "is" if len(names) == 1 else "are"
        return f"{name} cannot be taken yet: {listed(names)} {be} in the way of its easiest grasp.", None
    if answer.ways:
        return f"{name} cannot be taken: {listed(answer.ways[0].blockers)} would have to go first, and cannot.", None
    furniture = sorted({one for grasp in answer.grasps for one in grasp.furniture})
    because = f": the hand would touch {listed(furniture)}" if furniture else ""
    return f"{name} is out of reach for every grasp{because}.", None


def _put(scene: Scene, move: Put) -> tuple[str, Goal | None]:
    """Refusal of a move that puts the held object down, or its goal."""
    from planners.facts import At
    from planners.goals import Goal

    if scene.held is None:
        return "The hand is empty: take an object first.", None
    body = scene.body(scene.held.name)
    near = [
        other.name
        for other in scene.objects
        if other.name != body.name
        and other.bottom < move.z + (body.top - body.bottom)
        and other.top > move.z + _STAND_OFF
        and float(np.hypot(*(other.position[:2] - (move.x, move.y)))) < other.radius + body.radius + _STAND_OFF
    ]
    if near:
        stand = "stands" if len(near) == 1 else "stand"
        return f"{body.name} does not fit there: {listed(near)} {stand} too near.", None
    z = move.z + (body.top - body.bottom) / 2 if len(scene.supports) > 1 else None
    return "", Goal((At(body.name, move.x, move.y, z=z),))


def _moved_besides(found: Solution, own: str) -> list[str]:
    """Names of objects other than one that a plan takes."""
    return [name for name in dict.fromkeys(one.target for one in found.actions if one.name == "PickUp") if name != own]
