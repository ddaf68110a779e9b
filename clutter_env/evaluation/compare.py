"""A comparison: several policies on the same sets of scenes, one row of the table per policy and set."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from clutter_env import GOAL_FAMILIES
from clutter_env.errors import LearningError
from clutter_env.evaluation.evaluate import Evaluation, ResultRecords, evaluate, lower_bounds
from clutter_env.evaluation.policy_process import PolicyProcess
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.tables import Row, summarise
from clutter_env.policies.registry import load_policy, policy_families
from clutter_env.policies.runs import is_run, load_run, run_task
from clutter_env.reporting.files import json_text
from clutter_env.suites import Floor

CONTROLS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "retrieve": ("greedy", "random-skills", "direct-approach"),
        "rearrange": ("random",),
        "armretrieve": ("random",),
        **dict.fromkeys(GOAL_FAMILIES, ("random",)),
    }
)
"""Policies without training that play in every comparison, by the family of the environment."""


@dataclass(frozen=True)
class Comparison:
    """The policies and the scenes that are compared.

    Attributes:
        scene_sets: every policy plays those of them that it can play.
        policies: names for `load_policy`. A training run plays the sets with as many objects as it was trained on.
            `CONTROLS` play in any case.
        seed: of the built-in random policies and of the bootstrap.
        feasibility: of the Skill environment, for policies that act by skills.
        trust, python: for policies of Stable-Baselines3 and of LeRobot, see `load_policy`.

    Raises:
        PolicyError: an unknown policy, with the known ones.
        PolicyCrashed: the code of a policy raised an exception.
        LearningError: a policy that plays none of the scenes.
        SuiteError: no such suite or split.
    """

    scene_sets: Sequence[SceneSet]
    policies: Sequence[str] = ()
    seed: int = 0
    feasibility: str = "oracle"
    trust: bool = False
    python: str = ""

    def __post_init__(self) -> None:
        for name in self.policies:
            if ":" in name:  # code of others, which stays out of the process that scores
                PolicyProcess(name, self.seed, self.feasibility, self.trust, self.python).close()
            else:
                load_policy(name, self.seed)
        playing = {name for scenes in self.scene_sets for name in self.contenders(scenes)}
        idle = [name for name in self.policies if name not in playing]
        if idle:
            sets = ", ".join(scenes.name for scenes in self.scene_sets)
            raise LearningError(f"{', '.join(idle)} cannot play any of these scenes: {sets}")

    def contenders(self, scenes: SceneSet) -> list[str]:
        """The policies that play a set of scenes: those asked for, and the controls."""
        fitting = [name for name in self.policies if scenes.family in policy_families(name)]
        runs = {name: run_task(Path(name)).num_objects for name in fitting if is_run(name)}
        fitting = [name for name in fitting if runs.get(name, scenes.num_objects) == scenes.num_objects]
        return list(dict.fromkeys((*fitting, *CONTROLS.get(scenes.family, ()))))

    @property
    def num_episodes(self) -> int:
        """Number of episodes of all policies."""
        return sum(len(self.contenders(scenes)) * len(scenes.scenes) for scenes in self.scene_sets)


def compare(
    comparison: Comparison, records: ResultRecords | None = None, *, workers: int = 1, ray: str = "", **more: Any
) -> list[Row]:
    """Evaluate every policy on every set of scenes. Runs that differ in their seeds form one row.

    Args:
        comparison: the policies and the scenes.
        records: file of the scores, where an interrupted comparison goes on.
        workers, ray, more: as of `evaluate`, whose errors it raises.
    """
    rows = []
    chosen = {name: getattr(comparison, name) for name in ("seed", "feasibility", "trust", "python")}
    for scenes in comparison.scene_sets:
        contenders = comparison.contenders(scenes)
        names = {policy: policy for policy in contenders} | run_names(contenders)
        groups: dict[str, list[Evaluation]] = {}
        bounds: dict[str, tuple[Floor, ...]] = {}
        for policy in contenders:
            found = evaluate(policy, scenes, **chosen, workers=workers, ray=ray, records=records, **more)
            if scenes.family in ("retrieve", "rearrange") and not found.floors:
                grasps = found.traits.grasps
                if grasps not in bounds:
                    bounds[grasps] = lower_bounds(scenes, grasps, workers=workers, ray=ray, records=records)
                found = replace(found, floors=bounds[grasps])
            groups.setdefault(names[policy], []).append(found)
        rows += [summarise(name, group, comparison.seed) for name, group in groups.items()]
    return rows


def run_names(policies: Iterable[str]) -> dict[str, str]:
    """The name in a table of each policy that is a training run, by its own name.

    It is that of the algorithm. Runs of the same algorithm that differ in more than their seeds also have the names of
    their directories. Other policies are left out. Raises `LearningError` for a run and its copy.
    """
    groups: dict[str, list[str]] = {}
    found: dict[str, str] = {}
    for policy in filter(is_run, policies):
        record = load_run(Path(policy))
        if (same := found.setdefault(json_text(record), policy)) != policy:
            raise LearningError(f"{policy} and {same} are one run, not two seeds: their records are equal")
        groups.setdefault(json_text({**record, "seed": None}), []).append(policy)
    plain = [str(load_run(Path(group[0]))["algorithm"]) for group in groups.values()]
    names: dict[str, str] = {}
    for name, group in zip(plain, groups.values(), strict=True):
        # The directory of one of several seeds is named for the seed, its parent for the run.
        run = Path(group[0])
        folder = run.parent.name if run.name.startswith("seed-") else run.name
        names |= dict.fromkeys(group, name if plain.count(name) == 1 else f"{name}, {folder}")
    return names
