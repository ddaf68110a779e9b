"""How well the geometric test for obstructed targets agrees with the planner's minimum number of clearances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import gymnasium as gym

import clutter_env  # noqa: F401  registers the environments
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.reporting.tables import markdown_table
from clutter_env.scene.obstruction import count_blockers, side_approaches
from planners.cause import Cause
from planners.planner import Planner
from planners.scene import Scene

__all__ = ["SCENE_SETS", "Confusion", "SceneSet", "agreement", "agreement_table"]


class SceneSet(NamedTuple):
    """Scenes of one layout with a number of objects; the targets are drawn at random."""

    layout: str
    objects: int
    scenes: int


SCENE_SETS = (
    SceneSet("paper", 15, 700),
    SceneSet("paper", 25, 400),
    SceneSet("paper", 40, 300),
    SceneSet("dense", 25, 200),
    SceneSet("wide", 25, 200),
    SceneSet("island", 25, 200),
    SceneSet("shelf", 10, 200),
)
"""2,200 scenes."""


@dataclass
class Confusion:
    """Numbers of scenes, by what the test says and what the planner finds.

    Attributes:
        both: obstructed by both.
        neither: by neither; targets out of reach are not obstructed.
        test_only: obstructed by the test, while the planner finds a free grasp or none at all.
        planner_only: obstructed by the planner, while the test sees a free grasp or none at all.
    """

    both: int = 0
    neither: int = 0
    test_only: int = 0
    planner_only: int = 0

    @property
    def scenes(self) -> int:
        """All of them."""
        return self.both + self.neither + self.test_only + self.planner_only

    @property
    def agreement(self) -> float:
        """Share of the scenes on which test and planner agree."""
        return (self.both + self.neither) / self.scenes

    def add(self, by_test: bool, by_planner: bool) -> None:
        """Count one scene."""
        name = {(True, True): "both", (False, False): "neither", (True, False): "test_only"}.get(
            (by_test, by_planner), "planner_only"
        )
        setattr(self, name, getattr(self, name) + 1)


class _Job(NamedTuple):
    """One scene."""

    scene_set: SceneSet
    seed: int


def agreement(
    first_seed: int,
    workers: int,
    scene_sets: tuple[SceneSet, ...] = SCENE_SETS,
    tick: Callable[[], object] = lambda: None,
) -> dict[SceneSet, Confusion]:
    """Compare test and planner on scenes with consecutive seeds.

    Args:
        first_seed: of every set of scenes.
        workers: number of processes.
        scene_sets: which scenes.
        tick: called after every scene.

    Raises:
        RuntimeError: a worker failed.
    """
    found = {scene_set: Confusion() for scene_set in scene_sets}
    jobs = (_Job(one, first_seed + number) for one in scene_sets for number in range(one.scenes))
    for job, result in run_jobs(_compare, jobs, workers):
        if isinstance(result, Crash | Killed):
            raise RuntimeError(f"{job}: {result}")
        found[job.scene_set].add(*result)
        tick()
    return found


def agreement_table(found: dict[SceneSet, Confusion]) -> str:
    """One row for each set of scenes and one for all, as a Markdown table."""
    total = Confusion()
    for entry in found.values():
        for name in vars(total):
            setattr(total, name, getattr(total, name) + getattr(entry, name))
    rows = {f"{one.layout}, {one.objects} objects": entry for one, entry in found.items()} | {"all": total}
    head = ("scenes", "number", "both: obstructed", "both: not", "test only", "planner only", "agreement")
    cells = []
    for name, entry in rows.items():
        counts = (entry.scenes, entry.both, entry.neither, entry.test_only, entry.planner_only)
        cells.append((name, *map(str, counts), f"{entry.agreement:.1%}"))
    return markdown_table(head, cells)


def _compare(job: _Job) -> tuple[bool, bool]:
    """Whether the target is obstructed by the test and by the planner, in a worker."""
    env = _env(job.scene_set)
    _, info = env.reset(seed=job.seed)
    inner: Any = env.unwrapped
    robot = inner.robot
    blockers = count_blockers(side_approaches(robot.full_name), inner.layout, inner.world.scene, robot.max_opening)
    scene = Scene.from_mujoco(inner.model, inner.data, robot)
    floor = Planner(robot, grasps="side").clearance_floor(scene, info["target"])
    return bool(blockers[inner.target_slot] > 0), floor.count != 0 and floor.cause != Cause.UNREACHABLE


@cache
def _env(scene_set: SceneSet) -> gym.Env[Any, Any]:
    return gym.make("clutter_env/Retrieve-o15-v0", layout=scene_set.layout, num_objects=scene_set.objects)
