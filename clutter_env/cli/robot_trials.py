"""Scenes that a robot plans and executes before `clutter-env robot` says that no problem was found."""

from __future__ import annotations

from dataclasses import dataclass

import gymnasium as gym

import clutter_env
from assets import RobotSpec
from clutter_env.cli.clearance_trials import let_act
from clutter_env.reporting.progress import progress_bar, shown_compilation
from irm import cache_folder, cached_map, is_map_at_hand
from planners import ExpertConfig, TampExpert, map_parameters, warmup

assert clutter_env  # registers the environments

_OBJECTS = 5


@dataclass(frozen=True)
class SceneTrials:
    """Results of scenes, by their seeds: "" for a clean episode, else the reason for failure."""

    reasons: dict[int, str]

    @property
    def clean(self) -> int:
        """Number of clean episodes."""
        return sum(not reason for reason in self.reasons.values())

    @property
    def is_good(self) -> bool:
        """Whether most episodes are clean. The target of a single scene may be out of any robot's reach."""
        return 2 * self.clean > len(self.reasons)

    def __str__(self) -> str:
        failed = [f"seed {seed}: {reason}" for seed, reason in self.reasons.items() if reason]
        counts = f"{self.clean} of {len(self.reasons)} scenes with {_OBJECTS} objects planned and executed, clean"
        return "; ".join([counts, *failed])


def try_scenes(robot: RobotSpec, count: int) -> SceneTrials:
    """Plan and execute the scenes with five objects, seeds 0 to `count` - 1, with all grasps."""
    if not is_map_at_hand(robot, **map_parameters(robot)):
        print(f"building the reachability map, once; it is kept in {cache_folder()}", flush=True)
        cached_map(robot, progress=progress_bar, **map_parameters(robot))
    with shown_compilation():
        warmup(robot)
    env = gym.make(f"clutter_env/Retrieve-o{_OBJECTS}-v0", robot=robot, disable_env_checker=True)
    expert = TampExpert(env, grasps="all", config=ExpertConfig(with_floor=False))
    reasons = {}
    with progress_bar(desc="scenes", total=count, unit="scene") as bar:
        for seed in range(count):
            env.reset(seed=seed)
            expert.reset()
            info, lifted = let_act(expert, env)
            unclean = "lifted, but something has fallen, or was moved or pressed" if lifted else "no success in time"
            reasons[seed] = "" if info["is_success"] else expert.report.failure or unclean
            bar.update()
    env.close()
    return SceneTrials(reasons)
