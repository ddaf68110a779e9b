"""Sets of scenes on which policies are evaluated: those of a suite, or the resets of an environment."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, TypeAlias

import gymnasium as gym

from clutter_env.errors import LearningError
from clutter_env.policies.protocol import SKILLS
from clutter_env.seeds import HELD_OUT
from clutter_env.suites import Floor, SuiteScene, suite
from clutter_env.task import Task, family

_SKILL_ENV = "clutter_env/Skill-o15-v0"
"""The Skill environment. The number of objects is given separately."""


@dataclass(frozen=True)
class SeededScene:
    """The scene that an environment draws for a seed.

    Attributes:
        env_id: of the environment.
        keywords: keyword arguments of `gymnasium.make`.
        seed: of the reset.
        max_steps: steps after which an episode is over. None for the environment's own number.
    """

    env_id: str
    keywords: Mapping[str, Any]
    seed: int
    max_steps: int | None = None

    def make(self, **keywords: Any) -> gym.Env[Any, Any]:
        """The environment of this scene, with more keyword arguments that do not change the scene."""
        limit = {} if self.max_steps is None else {"max_episode_steps": self.max_steps}
        return Task(self.env_id, self.keywords).make(**limit, **keywords)

    def reset(self, env: gym.Env[Any, Any]) -> tuple[Any, dict[str, Any]]:
        """Start the episode of this scene, and return observation and info."""
        return env.reset(seed=self.seed)


Scene: TypeAlias = SuiteScene | SeededScene


@dataclass(frozen=True)
class SceneSet:
    """The scenes of a suite, or those that an environment draws for consecutive seeds.

    Attributes:
        suite: name of the suite, "" for the scenes of an environment.
        split: of the suite: "test" or "validation".
        env_id: of the environment, or "" for a suite.
        obstructed, layout: the environment's keyword arguments of these names. A suite has its own.
        objects: number of objects, or 0 for that of the environment.
        task: of Rearrange, or "" for that of the environment.
        count: number of scenes, or None for all of a suite.
        first_seed: of the environment's scenes.

    Raises:
        LearningError: neither a suite nor an environment is named, or both are. The number of scenes is below one or
            too large, or the seed is negative.
    """

    suite: str = ""
    split: str = "test"
    env_id: str = ""
    obstructed: bool | int = False
    layout: str = ""
    objects: int = 0
    task: str = ""
    count: int | None = None
    first_seed: int = HELD_OUT

    def __post_init__(self) -> None:
        if bool(self.suite) == bool(self.env_id):
            raise LearningError("scenes are those of a suite or of an environment: name one of them")
        most = len(suite(self.suite).split(self.split)) if self.suite else None
        if self.count is None and most is None:
            raise LearningError("say how many scenes of the environment are played")
        if self.count is not None and (self.count < 1 or (most is not None and self.count > most)):
            raise LearningError(f"scenes={self.count} is not valid; it must be from 1 to {most or 'any number'}")
        if self.first_seed < 0:
            raise LearningError(f"first_seed={self.first_seed} is not valid; seeds are not negative")

    @property
    def name(self) -> str:
        """As in a table: "side-15-v3", "side-15-v3 (validation)", "o15", "o15 obstructed 2", "swap-o8", "reach"."""
        if self.suite:
            name = suite(self.suite).name
            return name if self.split == "test" else f"{name} ({self.split})"
        name = self.env_id.rpartition("/")[2].removesuffix("-v0")
        short = f"o{self.objects}" if self.objects else name.partition("-")[2] or name.lower()
        if self.family == "rearrange":
            short = f"{self.task or family(self.env_id)}-{short}"
        degree = "" if self.obstructed is True else f" {self.obstructed}"
        layout = f" {self.layout}" if self.layout else ""
        return f"{short}{layout} obstructed{degree}" if self.obstructed else f"{short}{layout}"

    @property
    def family(self) -> str:
        """The family of the environment, see `clutter_env.task.family`. A suite's scenes are of "retrieve"."""
        return family(self.scenes[0].env_id)

    @property
    def has_floors(self) -> bool:
        """Whether it is a suite that knows lower bounds."""
        first = self.scenes[0]
        return isinstance(first, SuiteScene) and first.floor_side is not None

    @property
    def num_objects(self) -> int:
        """Number of objects on the table."""
        return Task(self.scenes[0].env_id, self.scenes[0].keywords).num_objects

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """The scenes, in order."""
        return _scenes(self)


@cache
def _scenes(wanted: SceneSet) -> tuple[Scene, ...]:
    if wanted.suite:
        return suite(wanted.suite).split(wanted.split)[: wanted.count]
    assert wanted.count is not None
    chosen = {"obstructed": wanted.obstructed, "layout": wanted.layout, "num_objects": wanted.objects}
    keywords = {name: value for name, value in {**chosen, "task": wanted.task}.items() if value}
    Task(wanted.env_id, keywords).make().close()
    seeds = range(wanted.first_seed, wanted.first_seed + wanted.count)
    return tuple(SeededScene(wanted.env_id, keywords, seed) for seed in seeds)


def scene_for(scene: Scene, acts_by_skills: bool, feasibility: str) -> Scene:
    """The scene as a policy plays it: by skills, one of Retrieve is one of Skill in physics with `SKILLS` skills.

    Raises:
        LearningError: there are no skills in the scene's environment.
    """
    if not acts_by_skills or family(scene.env_id) == "skill":
        return scene
    if family(scene.env_id) != "retrieve":
        raise LearningError(f"there are no skills in {scene.env_id}")
    count = Task(scene.env_id, scene.keywords).num_objects
    keywords = {**scene.keywords, "num_objects": count, "feasibility": feasibility, "budget": SKILLS}
    return replace(scene, env_id=_SKILL_ENV, keywords=keywords, max_steps=SKILLS)


def find_floor(scene: Scene, grasps: str) -> Floor:
    """The lower bound: that of the suite, or for a scene of an environment found by the planner. See `search_floor`.

    Raises:
        SuiteError: the suite has no lower bounds for these grasps.
    """
    if isinstance(scene, SuiteScene):
        return scene.floor(grasps)
    with closing(scene.make()) as env:
        _, info = scene.reset(env)
        return search_floor(env, info, grasps)


def search_floor(env: gym.Env[Any, Any], info: Mapping[str, Any], grasps: str) -> Floor:
    """The lower bound that the planner finds in the first state of a Retrieve or Rearrange environment.

    It counts clearances: picks beyond that of the target, or those of the objects that the goal wants elsewhere. What
    has to be opened counts as one more.
    """
    # The other policies do without the planner and its compiled kernels.
    from planners import Scene as PlannerScene, clearance_floor, lower_bound

    inner: Any = env.unwrapped
    if "unmet" not in info:
        read = PlannerScene.from_mujoco(inner.model, inner.data, inner.robot)
        if read.openings:
            bound = lower_bound(read, info["target"], grasps=grasps)
            count = None if bound.picks is None else bound.least - 1
            return Floor(count, bound.picks == bound.least, str(bound.cause))
        floor = clearance_floor(read, info["target"], grasps=grasps)
        return Floor(floor.count, floor.proved, str(floor.cause))
    read = PlannerScene.from_mujoco(inner.model, inner.data, inner.robot, regions=inner.regions)
    bound = lower_bound(read, inner.goal, grasps=grasps)
    return Floor(None if bound.picks is None else bound.picks - info["unmet"], bound.proved, str(bound.cause))
