"""Make the suites of scenes: seeds, targets, lower bounds and digests, one JSON file for each suite.

    python scripts/make_suites.py --names side-15-v1 side-25-v1

The files depend on the arguments `scenes` and `names` only. `--check` makes them again and compares them with those of
the package.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import tyro

import assets
from assets.robots import robot as find_robot
from clutter_env import OBJECT_COUNTS
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.reporting.files import json_text, write_atomically
from clutter_env.reporting.progress import progress_bar
from clutter_env.suites import GRASPS, SPLITS, content_digest, scene_digests
from planners.planner import Planner
from planners.scene import Scene

FORMAT = 1
SEEDS_PER_SPLIT = 5_000
"""Seeds set aside for a split; scenes that do not qualify use up more seeds than there are scenes."""


@dataclass(frozen=True)
class SuitePlan:
    """The scenes that a suite is to hold: number of objects, and keyword arguments of the environment."""

    name: str
    about: str
    objects: int
    keywords: dict[str, Any] = field(default_factory=dict)
    needs_clearing: bool = True
    """Only scenes with a proved lower bound of at least 1 for side grasps."""

    @property
    def env_id(self) -> str:
        """The environment with as many objects, or else the next smaller one."""
        return f"clutter_env/Retrieve-o{max(n for n in OBJECT_COUNTS if n <= self.objects)}-v0"

    @property
    def max_steps(self) -> int:
        """Control steps in an episode: the time limit of Retrieve with as many objects when the suites were made."""
        return 400 + 220 * self.objects

    @property
    def env_keywords(self) -> dict[str, Any]:
        """`keywords`, and what the environment's id does not say."""
        number = {} if self.objects in OBJECT_COUNTS else {"num_objects": self.objects}
        return {**self.keywords, "layout": self.keywords.get("layout", "paper"), **number}


PLANS = (
    SuitePlan("side-15-v1", "15 objects on the paper's table, an obstructed target", 15, {"obstructed": True}),
    SuitePlan("side-25-v1", "25 objects on the paper's table, an obstructed target", 25, {"obstructed": True}),
    SuitePlan("side-40-v1", "40 objects on the paper's table, an obstructed target", 40, {"obstructed": True}),
    SuitePlan("all-25-v1", "25 objects on the paper's table, targets as they come", 25, {}, False),
    SuitePlan(
        "shelf-10-v2", "10 objects in the shelf, an obstructed target", 10, {"layout": "shelf", "obstructed": True}
    ),
    SuitePlan(
        "shelf-16-v2", "16 objects in the shelf, an obstructed target", 16, {"layout": "shelf", "obstructed": True}
    ),
    SuitePlan(
        "dense-25-v1",
        "25 objects on the small table, an obstructed target",
        25,
        {"layout": "dense", "obstructed": True},
    ),
)
"""All suites. Their seeds follow from their places in this list: append, never insert."""
NAMES = tuple(plan.name for plan in PLANS)
FIRST_SEED = 2_000_000


class _Job(NamedTuple):
    """One seed of a suite."""

    env_id: str
    keywords: tuple[tuple[str, Any], ...]
    seed: int


def main(
    names: tuple[str, ...] = NAMES,
    scenes: int = 100,
    workers: int = 2,
    check: bool = False,
    out: Path = Path("outputs/suites"),
) -> None:
    """Make and write, or compare, suite by suite.

    Args:
        names: Suites to make.
        scenes: Scenes in each split.
        workers: Number of processes.
        check: Write nothing; fail if a file of the package differs from what is made now.
        out: Directory of the files.
    """
    plans = {plan.name: plan for plan in PLANS}
    if unknown := [name for name in names if name not in plans]:
        sys.exit(f"no suite {unknown[0]!r}; suites: {', '.join(plans)}")
    for name in names:
        packaged = assets.path(f"suites/{name}.json")
        with progress_bar(total=2 * scenes, desc=name, unit="scene") as bar:
            text = file_text(make_suite(plans[name], scenes, workers, bar.update))
        if not check:
            out.mkdir(parents=True, exist_ok=True)
            write_atomically(out / f"{name}.json", text.encode())
            print(f"written: {out / name}.json")
        elif packaged.read_text() != text:
            sys.exit(f"{packaged} differs from what is made now")
        else:
            print(f"identical: {packaged}")


def file_text(content: dict[str, Any]) -> str:
    """JSON with one scene a line."""
    splits = {
        split: "[\n" + ",\n".join(json_text(entry) for entry in entries) + "\n]"
        for split, entries in content["scenes"].items()
    }
    head = json_text({name: value for name, value in content.items() if name != "scenes"}, indent=1)
    lines = ",\n".join(f'"{split}": {text}' for split, text in splits.items())
    return head.removesuffix("\n}") + ',\n "scenes": {' + lines + "}\n}\n"


def make_suite(plan: SuitePlan, scenes: int, workers: int, tick: Callable[[], object] = lambda: None) -> dict[str, Any]:
    """The content of the suite's file, JSON values, whatever the number of workers.

    Raises:
        RuntimeError: a worker failed.
    """
    first = FIRST_SEED + PLANS.index(plan) * len(SPLITS) * SEEDS_PER_SPLIT
    splits = {
        split: _scenes(plan, first + number * SEEDS_PER_SPLIT, scenes, workers, tick)
        for number, split in enumerate(SPLITS)
    }
    content = {
        "name": plan.name,
        "format": FORMAT,
        "about": plan.about,
        "env_id": plan.env_id,
        "keywords": plan.env_keywords,
        "options": {},
        "max_steps": plan.max_steps,
        "made_with": {name: metadata.version(name) for name in ("mujoco", "numpy")},
        "scenes": splits,
    }
    return {**content, "sha256": content_digest(content)}


def _scenes(plan: SuitePlan, first: int, wanted: int, workers: int, tick: Callable[[], object]) -> list[dict[str, Any]]:
    """The first scenes that qualify, in the order of their seeds."""
    found: dict[int, dict[str, Any]] = {}
    chosen: list[dict[str, Any]] = []
    expected = first
    jobs = (_Job(plan.env_id, tuple(plan.env_keywords.items()), seed) for seed in count(first))
    for job, entry in run_jobs(_entry, jobs, workers):
        if isinstance(entry, Crash | Killed):
            raise RuntimeError(f"seed {job.seed} of suite {plan.name}: {entry}")
        found[job.seed] = entry
        while expected in found:
            entry = found.pop(expected)
            expected += 1
            if not plan.needs_clearing or (entry["floor_side"]["is_proved"] and entry["floor_side"]["count"]):
                chosen.append(entry)
                tick()
            if len(chosen) == wanted:
                return chosen
    raise RuntimeError(f"suite {plan.name}: the workers ended early")


def _entry(job: _Job) -> dict[str, Any]:
    """The entry of one scene in the suite's file."""
    env = _env(job.env_id, job.keywords)
    _, info = env.reset(seed=job.seed)
    inner: Any = env.unwrapped
    scene = Scene.from_mujoco(inner.model, inner.data, inner.robot)
    floors = {f"floor_{grasps}": _planner(grasps).clearance_floor(scene, info["target"]) for grasps in GRASPS}
    return {
        "seed": job.seed,
        "target": info["target"],
        **{name: {"count": f.count, "is_proved": f.proved, "cause": str(f.cause)} for name, f in floors.items()},
        "digests": scene_digests(env),
    }


@cache
def _env(env_id: str, keywords: tuple[tuple[str, Any], ...]) -> gym.Env[Any, Any]:
    return gym.make(env_id, **dict(keywords))


@cache
def _planner(grasps: str) -> Planner:
    return Planner(find_robot("fetch"), grasps=grasps)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
