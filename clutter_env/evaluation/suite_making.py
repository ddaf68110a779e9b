"""Making suites: which scenes qualify, with their lower bounds, time limits and digests.

The rules are those of docs/suites.md. `scripts/make_suites.py` makes the suites of the package by them, and
`clutter_env.evaluation.challenge` draws fresh scenes of the same kinds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym

from clutter_env import OBJECT_COUNTS, search_time_limit
from clutter_env.envs.rearrange_tasks import TASKS
from clutter_env.errors import SuiteError
from clutter_env.evaluation.scenes import search_floor
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.reporting.files import json_text, read_json
from clutter_env.suites import FILE, GRASPS, SPLITS, content_digest, scene_digests, suite

FORMAT = 2
SEEDS_PER_SPLIT = 5_000
"""Seeds set aside for a split. Scenes that do not qualify use up more seeds than there are scenes."""


class Rules(NamedTuple):
    """Rules for the scenes of a suite.

    Attributes:
        name: of the suite, for messages.
        env_id, keywords: of the environment that draws the scenes.
        clearances, is_solvable: as of `SuitePlan`.
    """

    name: str
    env_id: str
    keywords: tuple[tuple[str, Any], ...]
    clearances: int
    is_solvable: bool = False


@dataclass(frozen=True)
class SuitePlan:
    """The scenes that a suite is to hold: number of objects, and keyword arguments of the environment."""

    name: str
    about: str
    objects: int
    keywords: dict[str, Any] = field(default_factory=dict)
    clearances: int = 1
    """Only scenes with a proved lower bound of at least so many clearances for side grasps. 0: all scenes."""
    is_solvable: bool = False
    """Only scenes with a lower bound for grasps of all kinds: some objects of pieces are out of reach on the table."""
    task: str = ""
    """Of Rearrange, or "" for Retrieve."""
    is_hidden: bool = False
    """Of Search: without lower bounds, since nobody who plays knows the scene. All have the environment's time."""

    @property
    def env_id(self) -> str:
        """The environment with as many objects, or else the next smaller one."""
        if self.task:
            return f"clutter_env/Rearrange-o{self.objects}-v0"
        if self.is_hidden:
            return f"clutter_env/Search-o{self.objects}-v0"
        return f"clutter_env/Retrieve-o{max(n for n in OBJECT_COUNTS if n <= self.objects)}-v0"

    @property
    def env_keywords(self) -> dict[str, Any]:
        """`keywords`, and what the environment's id does not say."""
        if self.task:
            return {"task": self.task, "layout": TASKS[self.task].layout, **self.keywords}
        if self.is_hidden:
            return self.keywords
        number = {} if self.objects in OBJECT_COUNTS else {"num_objects": self.objects}
        return {**self.keywords, "layout": self.keywords.get("layout", "paper"), **number}

    @property
    def rules(self) -> Rules:
        """By which scenes qualify."""
        return Rules(self.name, self.env_id, tuple(self.env_keywords.items()), self.clearances, self.is_solvable)


_BLOCKED = {"obstructed": True}
_IN_SHELF, _DENSE = {"layout": "shelf", **_BLOCKED}, {"layout": "dense", **_BLOCKED}
_KINDS, _HOUSEHOLD = {"object_set": "household"}, "household objects of twelve kinds"
_HIDDEN = "a target that no camera sees"
_SHUT_DRAWER, _SHUT_DOOR = "a drawer that is shut", "a door that is shut"
PLANS = (
    SuitePlan("side-15-v3", "15 objects on the paper's table, an obstructed target", 15, _BLOCKED),
    SuitePlan("side-25-v3", "25 objects on the paper's table, an obstructed target", 25, _BLOCKED),
    SuitePlan("side-40-v3", "40 objects on the paper's table, an obstructed target", 40, _BLOCKED),
    SuitePlan("all-25-v3", "25 objects on the paper's table, targets as they come", 25, {}, clearances=0),
    SuitePlan("shelf-10-v4", "10 objects in the shelf, an obstructed target", 10, _IN_SHELF),
    SuitePlan("shelf-16-v4", "16 objects in the shelf, an obstructed target", 16, _IN_SHELF),
    SuitePlan("dense-25-v3", "25 objects on the small table, an obstructed target", 25, _DENSE),
    SuitePlan("deep-15-v2", "15 objects on the paper's table, 3 or more to clear", 15, _BLOCKED, clearances=3),
    SuitePlan("deep-25-v2", "25 objects on the paper's table, 3 or more to clear", 25, _BLOCKED, clearances=3),
    SuitePlan("deep-shelf-12-v2", "12 objects in the shelf, 2 or more to clear", 12, _IN_SHELF, clearances=2),
    SuitePlan("sort-8-v3", "8 objects to be sorted into three trays", 8, clearances=0, task="sort"),
    SuitePlan("sort-20-v3", "20 objects to be sorted into three trays", 20, clearances=0, task="sort"),
    SuitePlan("set-12-v3", "6 of 12 objects to be put into places of their own", 12, clearances=0, task="set"),
    SuitePlan("swap-8-v3", "2 to 6 of 8 objects to change places", 8, clearances=0, task="swap"),
    SuitePlan("stack-8-v3", "3 of 8 blocks to be stacked, 3 stand in a stack", 8, clearances=0, task="stack"),
    SuitePlan("fetch-8-v3", "3 of 8 objects to be brought to a second table", 8, clearances=0, task="fetch"),
    SuitePlan("hidden-shelf-10-v2", f"10 objects in the shelf, {_HIDDEN}", 10, {"layout": "shelf"}, 0, is_hidden=True),
    SuitePlan(
        "hidden-cabinet-12-v2", f"12 objects in the cabinet, {_HIDDEN}", 12, {"layout": "cabinet"}, 0, is_hidden=True
    ),
    SuitePlan("hidden-shelf-16-v2", f"16 objects in the shelf, {_HIDDEN}", 16, {"layout": "shelf"}, 0, is_hidden=True),
    SuitePlan("household-15-v2", f"15 {_HOUSEHOLD} on the paper's table", 15, _KINDS, 0, is_solvable=True),
    SuitePlan(
        "household-shelf-10-v2", f"10 {_HOUSEHOLD} in the shelf", 10, {"layout": "shelf", **_KINDS}, 0, is_solvable=True
    ),
    SuitePlan("drawer-5-v1", f"5 objects in {_SHUT_DRAWER}", 5, {"layout": "drawer"}, 0, is_solvable=True),
    SuitePlan("cupboard-5-v1", f"5 objects behind {_SHUT_DOOR}", 5, {"layout": "cupboard"}, 0, is_solvable=True),
    SuitePlan("fridge-10-v1", f"10 objects on three boards behind {_SHUT_DOOR}", 10, {"layout": "fridge"}, 0, True),
    SuitePlan(
        "blocked-drawer-5-v1",
        f"5 objects in {_SHUT_DRAWER} and in its way",
        5,
        {"layout": "blocked_drawer"},
        0,
        is_solvable=True,
    ),
)
"""All suites. Their seeds follow from their places in this list: append, never insert."""
NAMES = tuple(plan.name for plan in PLANS)
FIRST_SEED = 2_000_000
MOST_TRIED = 50_000
"""Largest number of seeds to try for fresh scenes. Of the rarest suite one in 19 qualifies."""
STEPS_PER_PICK = 1500
"""Control steps that a time limit allows for each pick of the lower bound. This is more than twice what the expert
needs, see docs/suites.md."""
LONGEST = 22_500
"""Control steps of the longest time limit: longer ones would void the proof in `clutter_env.envs.reward`."""


class _Job(NamedTuple):
    """One seed of a suite."""

    rules: Rules
    seed: int


def step_limit(clearances: int, wanted: int = 1) -> int:
    """The time limit of a scene [control steps], whatever else is in it and whoever plays: all have the same time.

    Args:
        clearances: the scene's lower bound for side grasps, or for grasps of all kinds if no side grasp has a plan.
        wanted: number of objects that the goal wants elsewhere.
    """
    return min(STEPS_PER_PICK * (wanted + clearances), LONGEST)


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
        SuiteError: too few seeds qualify.
        RuntimeError: a worker failed.
    """
    first = FIRST_SEED + PLANS.index(plan) * len(SPLITS) * SEEDS_PER_SPLIT
    seeds = [range(first + number * SEEDS_PER_SPLIT, first + (number + 1) * SEEDS_PER_SPLIT) for number in range(2)]
    splits = {split: qualifying(plan.rules, of, scenes, workers, tick) for split, of in zip(SPLITS, seeds, strict=True)}
    return suite_content(plan, plan.name, splits)


def rules_of(name: str) -> Rules:
    """The rules of a suite of the package, or of the one of whose kind a challenge's scenes are.

    Of another suite, that is a file: proved lower bounds that are no lower than the least of its own.

    Raises:
        SuiteError: there is no such suite.
    """
    made = suite(name)
    of = read_json(Path(name)).get("challenge", {}).get("entry", {}).get("suite") if name.endswith(FILE) else name
    if of in NAMES:
        return PLANS[NAMES.index(of)].rules
    first = made.split(SPLITS[0])[0]
    least = min((scene.floor_side.count or 0 if scene.floor_side else 0) for scene in made.split(SPLITS[0]))
    return Rules(made.name, first.env_id, tuple(first.keywords.items()), least)


def suite_content(plan: SuitePlan, name: str, splits: dict[str, list[dict[str, Any]]], **more: Any) -> dict[str, Any]:
    """The content of a suite's file with these scenes, and more entries."""
    return content_of(plan.rules, plan.about, name, splits, **more)


def content_of(
    rules: Rules, about: str, name: str, splits: dict[str, list[dict[str, Any]]], **more: Any
) -> dict[str, Any]:
    """The content of a suite's file with these scenes, that qualify by these rules, and more entries."""
    content = {
        "name": name,
        "format": FORMAT,
        "about": about,
        "env_id": rules.env_id,
        "keywords": dict(rules.keywords),
        "options": {},
        "made_with": {name: metadata.version(name) for name in ("mujoco", "numpy")},
        **more,
        "scenes": splits,
    }
    return {**content, "sha256": content_digest(content)}


def qualifying(
    rules: Rules, seeds: Sequence[int], wanted: int, workers: int, tick: Callable[[], object] = lambda: None
) -> list[dict[str, Any]]:
    """The first scenes that a suite's rules admit, in the order of their seeds: entries of its file.

    Raises:
        SuiteError: too few seeds qualify.
        RuntimeError: a worker failed.
    """
    found: dict[int, dict[str, Any] | None] = {}
    chosen: list[dict[str, Any]] = []
    waiting = iter(seeds)
    expected = next(waiting)
    jobs = (_Job(rules, seed) for seed in seeds)
    for job, result in run_jobs(_entry, jobs, workers):
        if isinstance(result, Crash | Killed):
            raise RuntimeError(f"seed {job.seed} of suite {rules.name}: {result}")
        found[job.seed] = result
        while expected in found:
            entry = found.pop(expected)
            expected = next(waiting, -1)
            if entry is not None:
                chosen.append(entry)
                tick()
            if len(chosen) == wanted:
                return chosen
    raise SuiteError(f"suite {rules.name}: {len(chosen)} of {len(seeds)} seeds qualify; {wanted} are wanted")


def _entry(job: _Job) -> dict[str, Any] | None:
    """The entry of one scene in the suite's file, None if it does not qualify."""
    rules = job.rules
    env = _env(rules.env_id, rules.keywords)
    _, info = env.reset(seed=job.seed)
    if "/Search-" in rules.env_id:
        floors = dict.fromkeys([f"floor_{grasps}" for grasps in GRASPS])
        steps = search_time_limit(env.get_wrapper_attr("config").num_objects)
        return {"seed": job.seed, "target": info["target"], "max_steps": steps, **floors, "digests": scene_digests(env)}
    wanted = info.get("unmet", 1)
    if not wanted:
        return None
    found = {}
    for grasps in GRASPS:
        floor = found[f"floor_{grasps}"] = search_floor(env, info, grasps)
        if grasps == "side" and rules.clearances and not (floor.is_proved and (floor.count or 0) >= rules.clearances):
            return None
    is_known = all(floor.is_proved or floor.cause for floor in found.values())
    if rules.is_solvable and (found["floor_all"].count is None or not is_known):
        return None
    counts = [floor.count for floor in found.values() if floor.count is not None]
    return {
        "seed": job.seed,
        "target": info["target"],
        "max_steps": step_limit(max(counts, default=0), wanted),
        **{name: asdict(floor) for name, floor in found.items()},
        "digests": scene_digests(env),
    }


@cache
def _env(env_id: str, keywords: tuple[tuple[str, Any], ...]) -> gym.Env[Any, Any]:
    return gym.make(env_id, **dict(keywords))
