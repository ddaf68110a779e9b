"""`Rearrange`: bring the objects where a goal wants them: sort, set, swap, stack, fetch, or a goal of the user's."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from gymnasium import spaces

from clutter_env.config import EnvConfig
from clutter_env.envs.goal_monitor import GoalMemory, GoalMonitor, goal_potential, read_regions, start_scene
from clutter_env.envs.observation import POSITION_BOUND, Column, EntryLayout
from clutter_env.envs.rearrange_tasks import TASKS, DrawnGoal
from clutter_env.envs.reset_options import ResetOptions
from clutter_env.envs.retrieve import ClutterTaskEnv
from clutter_env.errors import ConfigError, OptionError, StateError, check_choice, check_integer
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.model import TRAY_COLOURS
from clutter_env.simulation.world import Mark
from planners.goals import At, Goal, GoalError, On, Region
from planners.scene import Scene, SceneError

_KINDS = ("in_area", "at_point", "on_object", "held_up")
"""Kinds of `goal_monitor.Place`, a column each."""
GOAL_ROW = EntryLayout(
    {
        "has_goal": [Column("has_goal", "", 1.0)],
        "kind": [Column(name, "", 1.0) for name in _KINDS],
        "centre": [Column(axis, "m", POSITION_BOUND) for axis in "xyz"],
        "heading": [Column("sin_yaw", "", 1.0), Column("cos_yaw", "", 1.0)],
        "half_extents": [Column("half_x", "m", POSITION_BOUND), Column("half_y", "m", POSITION_BOUND)],
        "below": [Column("below", "", 64.0)],
        "met": [Column("met", "", 1.0)],
    }
)
"""The row of one object in the observation's entry "goals". See docs/environments/rearrange.md."""


_GREY = (0.62, 0.63, 0.65, 1.0)
"""Colour of objects that the goal does not name."""
_MARK_SIZE = 1.3
"""Size of the mark at a place relative to that of its object."""
_MARK_ALPHA = 0.45
"""Opacity of the marks that pictures show where objects are to be put."""


@dataclass(frozen=True)
class RearrangeConfig(EnvConfig):
    """The keyword arguments of `RearrangeEnv`: those of `EnvConfig`, and `task`.

    Raises:
        ConfigError: see `EnvConfig`. Or the layout does not suit the task.
    """

    num_objects: int = 8
    layout: Any = ""
    """Table and surroundings, as in `EnvConfig`. Those of the task if not given."""
    object_set: str = ""
    """Sizes and masses of random objects. Those of the task if not given."""
    shapes: str = ""
    """Shapes of the objects. Those of the task if not given."""
    task: str = "sort"
    """Name of the task, in `TASKS`."""

    def __post_init__(self) -> None:
        check_choice("task", self.task, TASKS)
        for name in ("layout", "object_set", "shapes"):
            if getattr(self, name) == "":
                object.__setattr__(self, name, getattr(TASKS[self.task], name))
        for name in ("obstructed", "terminate_on_fallen"):
            check_choice(name, getattr(self, name), (getattr(EnvConfig, name),))
        super().__post_init__()
        check_integer("num_objects", self.num_objects, TASKS[self.task].least)
        if problem := self.task_problem(self.task):
            raise ConfigError(problem)

    def task_problem(self, name: str) -> str:
        """Reason why a task cannot be set in this layout, "" if it can."""
        task, layout = TASKS[name], self.find_layout()
        if task.fits(layout):
            return ""
        needs = f"a support whose name begins with {task.needs!r}"
        return f"task {name!r} needs {needs}, as layout {task.layout!r} has; layout {layout.name!r} has none"


@dataclass(frozen=True)
class RearrangeOptions(ResetOptions):
    """The options of a reset, their types checked."""

    task: str | None = None
    goal: Goal | None = None
    regions: tuple[Region, ...] = field(default=())

    @classmethod
    def of(cls, options: object) -> Self:
        """Check the dictionary given to `reset`.

        Raises:
            OptionError: see `ResetOptions.of`. Or not a task, a goal or regions.
        """
        known = ("objects", "state", "base", "task", "goal", "regions")
        if isinstance(options, Mapping):
            for name in options:
                if name not in known:
                    raise OptionError(f"unknown option {name!r}; known options: {', '.join(known)}")
        checked = super().of(options)
        if checked.task is not None:
            check_choice("option 'task'", checked.task, TASKS, OptionError)
        if checked.task is not None and checked.goal is not None:
            raise OptionError("option 'goal' says what is to be done; give it without option 'task'")
        try:
            goal = None if checked.goal is None else Goal.of(checked.goal)
            return replace(checked, goal=goal, regions=read_regions(checked.regions))
        except GoalError as problem:
            raise OptionError(str(problem)) from None


class RearrangeEnv(ClutterTaskEnv):
    """A mobile manipulator in front of a table, and a goal for the positions of objects.

    Keyword arguments are the fields of `RearrangeConfig`. Reset options: `task` (another one that the layout permits),
    `objects`, `base` (as in `RetrieveEnv`), `goal` (a `planners.goals.Goal` or its PDDL text) with `regions` that it
    names, and `state`. The info has the keys of `RetrieveEnv`'s, and `goal` (str, PDDL) and `unmet` (int, facts of the
    goal that do not hold). `lifted` says that the goal holds, whatever else has happened. `target` is "".

    The goal is reached when it has held for 0.5 s while the robot touches no object that the goal places. With
    `success="clean"` every object that had to move was carried. Nothing may have toppled, or travelled other than in
    the air, in the gripper. The robot may not have pressed hard on the furniture, see `success`. The episode ends with
    success, or when an object of the goal has fallen off all supports.

    Example:
        >>> import gymnasium as gym, clutter_env
        >>> env = gym.make("clutter_env/Rearrange-o4-v0", task="stack")
        >>> observation, info = env.reset(seed=0)
        >>> info["unmet"]
        3
    """

    config: RearrangeConfig
    opens = (None, "door_left", "door_right")
    has_target = _shows_goal = False
    task_modules = (
        "clutter_env.envs.goal_monitor",
        "clutter_env.envs.rearrange_tasks",
        "planners.goals",
        "planners.regions",
    )

    def __init__(self, **keywords: Any) -> None:
        super().__init__(RearrangeConfig.from_keywords(keywords))
        self._drawn: tuple[Goal, Scene]
        self._potential = 0.0

    @property
    def goal(self) -> Goal:
        """The goal of this episode.

        Raises:
            ActionError: `reset` has not been called.
        """
        self.check_started("goal")
        return self._goal_monitor.goal

    @property
    def regions(self) -> tuple[Region, ...]:
        """The regions that the goal may name. Raise ActionError before `reset`."""
        self.check_started("regions")
        return self._goal_monitor.regions

    @property
    def observation_layout(self) -> Mapping[str, EntryLayout]:
        """Slices and columns of the observation's entries, by name. Those of "goals" and "objects" describe one row."""
        return MappingProxyType({**super().observation_layout, "goals": GOAL_ROW})

    # What the task defines.

    def _check_options(self, options: object) -> ResetOptions:
        return RearrangeOptions.of(options)

    def _draw_scene(self, options: ResetOptions) -> TableScene:
        assert isinstance(options, RearrangeOptions)
        name = options.task or self.config.task
        task = TASKS[name]
        if problem := self.config.task_problem(name):
            raise OptionError(f"option 'task': {problem}")
        scene = replace(super()._draw_scene(options), target=-1)
        if options.goal is None and scene.num_objects < task.least:
            raise OptionError(f"task {name!r} needs {task.least} objects; there are {scene.num_objects}")
        if options.objects is None and options.goal is None:
            scene = task.arrange(self.np_random, scene)
        if options.goal is not None:
            drawn = DrawnGoal(options.goal, options.regions)
        else:
            drawn = task.draw(self.np_random, self.layout, scene)
        try:
            self._drawn = drawn.goal, start_scene(self.robot, self.layout, scene, drawn.regions, drawn.goal)
        except (GoalError, SceneError) as problem:
            raise OptionError(f"option 'goal': {problem}") from None
        return scene

    def _begin(self) -> None:
        goal, start = self._drawn
        self._follow(GoalMonitor(self.world, start, goal))

    def _advance(self) -> tuple[float, bool]:
        self._goal_monitor.update(self.measurements)
        return super()._advance()

    def _observe(self) -> dict[str, Any]:
        goals = self._rows.copy()
        unmet = {getattr(fact, "object", "") for fact in self._goal_monitor.unmet}
        for slot in self._goal_monitor.places:
            goals[slot, GOAL_ROW["met"]] = self.world.names[slot] not in unmet
        return {**self.observe_world(-1, 0.0, 0.0), "goals": goals.ravel()}

    def _info(self) -> dict[str, Any]:
        monitor = self._goal_monitor
        return {
            **super()._info(),
            "lifted": monitor.is_reached,
            "goal": monitor.goal.to_pddl(),
            "unmet": len(monitor.unmet),
        }

    def _is_reached(self) -> bool:
        return self._goal_monitor.is_reached

    def _is_success(self) -> bool:
        is_carried_out = self.config.success == "lifted" or self._goal_monitor.is_carried_out
        return is_carried_out and super()._is_success()

    def _is_over(self) -> bool:
        return self._is_success() or self._goal_monitor.is_lost(self.measurements)

    def _memory(self) -> dict[str, Any]:
        return self._goal_monitor.memory()

    def _read_memory(self, memory: Any, scene: TableScene) -> tuple[GoalMemory, Scene]:
        read = GoalMemory.read(memory, scene.num_objects)
        try:
            return read, start_scene(self.robot, self.layout, scene, read.regions, read.goal)
        except (GoalError, SceneError) as problem:
            raise StateError(f"memory task: goal of the state: {problem}") from None

    def _recall(self, bookkeeping: tuple[GoalMemory, Scene]) -> None:
        memory, start = bookkeeping
        self._follow(GoalMonitor.recall(memory, self.world, start, self.measurements))

    # Inside.

    def _follow(self, monitor: GoalMonitor) -> None:
        """Make this the monitor of the episode, and record the properties that follow from its goal."""
        self._goal_monitor = monitor
        self._monitor.named = {self.world.names.index(name) for name in monitor.moving}
        self._rows = np.zeros((self.config.num_objects, GOAL_ROW.size), np.float32)
        for slot, place in monitor.places.items():
            row = self._rows[slot]
            row[GOAL_ROW["has_goal"]], row[GOAL_ROW["below"]] = 1.0, place.below
            row[GOAL_ROW["kind"]][_KINDS.index(place.kind)] = 1.0
            row[GOAL_ROW["centre"]], row[GOAL_ROW["half_extents"]] = place.centre, place.half_extents
            row[GOAL_ROW["heading"]] = (0.0, 0.0) if place.yaw is None else (math.sin(place.yaw), math.cos(place.yaw))
        self._paint(monitor)
        self._potential = self._measure_potential()

    def _paint(self, monitor: GoalMonitor) -> None:
        """Colour the objects. Objects for trays get the tray's colour. Other objects of the goal get their own, which
        their marks share. The rest is grey."""
        world, scene = self.world, self.world.scene
        for slot in set(range(len(world.names))) - {world.names.index(name) for name in monitor.named}:
            world.colour(slot)[:] = _GREY
        for fact in monitor.goal.placed:
            if isinstance(fact, On) and fact.place in TRAY_COLOURS:
                world.colour(world.names.index(fact.object))[:] = TRAY_COLOURS[fact.place]
        marked = {region.name for region in monitor.regions}
        marks = []
        for fact in monitor.goal.placed:
            slot = world.names.index(fact.object)
            place, colour = monitor.places[slot], (*world.colour(slot)[:3], _MARK_ALPHA)
            if isinstance(fact, At):
                half = _MARK_SIZE * scene.standing_extents[slot, :2]
                marks.append(Mark(place.centre, half, place.yaw or 0.0, np.array(colour)))
            elif (fact.place if isinstance(fact, On) else fact.region) in marked:
                marks.append(Mark(place.centre, place.half_extents, place.yaw or 0.0, np.array(colour)))
        world.marks = tuple(marks)

    def _potential_now(self) -> float:
        return goal_potential(self._goal_monitor, self.measurements)

    def _make_observation_space(self) -> spaces.Dict:
        bounds = np.tile(GOAL_ROW.bounds, self.config.num_objects).astype(np.float32)
        parts = super()._make_observation_space()
        return spaces.Dict({**parts.spaces, "goals": spaces.Box(-bounds, bounds, dtype=np.float32)})
