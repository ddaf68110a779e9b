"""Collection of decisions without physics: scenes are drawn and planned canonically, nothing is simulated."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import gymnasium as gym
import numpy as np

from clutter_env.learning.demonstrations.decision_file import DECISION_COLUMNS, Decisions, chunk_path, read_chunk
from clutter_env.learning.demonstrations.decision_labels import decisions_of
from clutter_env.learning.errors import CollectionError, DatasetError, LearningError
from clutter_env.learning.task import HELD_OUT, Task, versions
from clutter_env.parallel import Crash, Killed
from clutter_env.reporting.files import json_text, write_atomically, write_json
from planners import Alternatives, Planner, Scene, SceneError, Solution, find_grasp_set

__all__ = [
    "SEEDS_PER_CHUNK",
    "Chunk",
    "DecisionJob",
    "canonical_plan",
    "collect_decisions",
    "decide_chunk",
    "drawn_scene",
]

SEEDS_PER_CHUNK = 20
_IDENTITY = "dataset.json"


@dataclass(frozen=True)
class DecisionJob:
    """What is collected.

    Attributes:
        task: a Retrieve environment and its keyword arguments; scenes are drawn in it.
        grasps: name of the grasp set.
        decisions: wanted at least.
        first_seed: of the scenes, below `HELD_OUT`.

    Raises:
        LearningError: a value out of its range.
        UnknownGraspSet: no grasp set of that name.
    """

    task: Task
    grasps: str
    decisions: int
    first_seed: int = 0

    def __post_init__(self) -> None:
        find_grasp_set(self.grasps)
        if self.task.family != "retrieve":
            raise LearningError(f"{self.task.env_id} is not valid; decisions are collected in Retrieve environments")
        if self.decisions < 1:
            raise LearningError(f"decisions={self.decisions} is not valid; it must be at least 1")
        if not 0 <= self.first_seed < HELD_OUT:
            raise LearningError(f"seed={self.first_seed} is not valid; it must be from 0 to {HELD_OUT - 1}")

    def identity(self) -> dict[str, Any]:
        """All that determines the decisions of a seed, and the meaning of the columns, as JSON values."""
        columns = {name: columns for name, (_, columns) in DECISION_COLUMNS.items()}
        content = {"task": self.task, "grasps": self.grasps, "first_seed": self.first_seed, "versions": versions()}
        return dict(json.loads(json_text({**content, "seeds_per_chunk": SEEDS_PER_CHUNK, "columns": columns})))


class Chunk(NamedTuple):
    """The decisions of `SEEDS_PER_CHUNK` seeds: the file's content, how many decisions, and seeds without a plan."""

    content: bytes
    decisions: int
    without_plan: int


class ChunkRunner(Protocol):
    """Runs `decide_chunk` on first seeds in parallel: `run_jobs` with its number of workers chosen."""

    def __call__(
        self, function: Callable[[int], Chunk], jobs: Iterable[int | None]
    ) -> Iterator[tuple[int, Chunk | Crash | Killed]]:
        """Pairs of first seed and chunk; see `run_jobs`."""
        ...


def decide_chunk(job: DecisionJob, first_seed: int) -> Chunk:
    """Plan the scenes of one chunk and label their decisions; runs in a worker."""
    env = job.task.make()
    try:
        rows, without_plan, alternatives = [], 0, None
        num_objects = int(env.unwrapped.config.num_objects)  # type: ignore[attr-defined]  # gymnasium's Env has no config
        planner = Planner(env.get_wrapper_attr("robot"), grasps=job.grasps, canonical=True)
        for seed in range(first_seed, min(first_seed + SEEDS_PER_CHUNK, HELD_OUT)):
            scene, target = drawn_scene(env, seed)
            alternatives = alternatives or Alternatives.of(planner, scene)
            solution = canonical_plan(planner, scene, target)
            if solution is None:
                without_plan += 1
                continue
            rows += [{"seed": seed, **row} for row in decisions_of(solution, alternatives, num_objects)]
    finally:
        env.close()
    assert alternatives is not None
    pitches = np.array([family.pitch for family in alternatives.grasps.families])
    decisions = Decisions.of(rows, alternatives.cells(scene), pitches)
    return Chunk(decisions.to_bytes(), len(decisions), without_plan)


def drawn_scene(env: gym.Env[Any, Any], seed: int) -> tuple[Scene, str]:
    """The scene of a seed, and its target."""
    _, info = env.reset(seed=seed)
    own: Any = env.unwrapped
    scene = Scene.from_mujoco(own.model, own.data, own.robot, movable=own.object_names, support=own.support_name)
    return scene, str(info["target"])


def canonical_plan(planner: Planner, scene: Scene, target: str) -> Solution | None:
    """The canonical plan of a scene, if there is one."""
    try:
        found = planner.solve(scene, target)
    except SceneError:
        return None
    return found if isinstance(found, Solution) else None


def collect_decisions(
    job: DecisionJob, directory: Path, run: ChunkRunner, report: Callable[[int], None] = lambda _: None
) -> dict[str, int]:
    """Collect chunk after chunk until there are enough decisions; chunks that are there already are not made again.

    Args:
        job: what to collect.
        directory: where to.
        run: for example `partial(run_jobs, workers=2)`.
        report: called with the number of decisions of every chunk.

    Returns:
        How many `decisions` there are, how many `made` now, and seeds `without_plan` among these.

    Raises:
        DatasetError: the directory holds the decisions of another job.
        CollectionError: a worker died or failed; run the same command again to go on.
    """
    _open(job, directory)
    counts = {"decisions": 0, "made": 0, "without_plan": 0}

    def first_seeds() -> Iterator[int | None]:
        """Of the chunks that are not there yet, until there are enough decisions."""
        for first in range(job.first_seed, HELD_OUT, SEEDS_PER_CHUNK):
            path = chunk_path(directory, first)
            if counts["decisions"] >= job.decisions:
                return
            if not path.exists():
                yield first
                continue
            counts["decisions"] += len(read_chunk(path))
            report(counts["decisions"])

    for first, chunk in run(partial(decide_chunk, job), first_seeds()):
        if not isinstance(chunk, Chunk):
            raise CollectionError(f"the scenes from seed {first} on could not be planned: {_summary(chunk)}")
        write_atomically(chunk_path(directory, first), chunk.content)
        counts["decisions"] += chunk.decisions
        counts["made"] += chunk.decisions
        counts["without_plan"] += chunk.without_plan
        report(counts["decisions"])
    return counts


def _summary(problem: Crash | Killed) -> str:
    return problem.summary if isinstance(problem, Crash) else f"killed after {problem.seconds:.0f} s"


def _open(job: DecisionJob, directory: Path) -> None:
    """Describe the job in the directory; refuse one that holds something else."""
    described, wanted = directory / _IDENTITY, job.identity()
    if not described.exists():
        if directory.exists() and any(directory.iterdir()):
            raise DatasetError(f"{directory} exists and holds other files; choose another directory")
        (directory / "chunks").mkdir(parents=True)
        write_json(described, wanted)
    there: Mapping[str, Any] = json.loads(described.read_text())
    different = [name for name in wanted if there.get(name) != wanted[name]]
    if different:
        raise DatasetError(f"{directory} was collected with other {', '.join(different)}; choose another directory")
