"""How searches go: the expert, its baselines and the all-knowing expert on the same scenes; what perception gets wrong.

    python scripts/search_table.py --suite hidden-shelf-10-v2 --scenes 10
    python scripts/search_table.py --perception --scenes 10 --depth-noise 0.005
    python scripts/search_table.py --layout drawers --scenes 50 --policies expected

Episodes are kept in a file, one a line: a run that was interrupted goes on where it was.
"""

from __future__ import annotations

import json
import math
import time
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import tyro

import clutter_env
from clutter_env.policies.playing import played
from clutter_env.reporting.intervals import wilson
from clutter_env.suites import SuiteScene
from planners import ExpertConfig, Scene, SearchExpert, TampExpert
from planners.drawing.pictures import draw_search
from planners.search.perception import Description, View, perceive
from planners.search.sensing import RobotReading

POLICIES = ("expected", "random", "front", "shadow", "all-knowing")
_FRAMES = {"frame_every": 10}
_GREY = (0.5, 0.5, 0.5)
"""Colour of no object: a target of it is absent. The scene's own target is then an object like the others."""


@dataclass(frozen=True)
class Arguments:
    """What to play."""

    suite: str = "hidden-shelf-10-v2"
    scenes: int = 10
    """The first so many of the test split."""
    layout: str = ""
    """Scenes of a layout, drawn from seeds, instead of a suite's."""
    objects: int = 5
    """In each of these."""
    first_seed: int = 2000
    policies: tuple[str, ...] = POLICIES
    mask_errors: float = 0.0
    depth_noise: float = 0.0
    absent: bool = False
    """Look for a target that is not there."""
    perception: bool = False
    """Measure the errors of perception in the first views instead."""
    picture: Path | None = None
    """Draw the belief at each decision of the expert in the last of the scenes instead."""
    out: Path = Path("outputs/search.jsonl")


@dataclass(frozen=True)
class Drawn:
    """A scene of a layout, with the names that a suite's has: `index` is the seed."""

    layout: str
    objects: int
    index: int

    @property
    def suite(self) -> str:
        """Name of all such scenes."""
        return f"{self.layout} with {self.objects}"

    @property
    def seed(self) -> int:
        """Of the reset."""
        return self.index

    def make(self, **keywords: Any) -> gym.Env[Any, Any]:
        """The environment, with more keyword arguments."""
        return gym.make(f"clutter_env/Search-o{self.objects}-v0", layout=self.layout, **keywords)

    def reset(self, env: gym.Env[Any, Any]) -> tuple[Any, dict[str, Any]]:
        """Start the episode; observation and info."""
        return env.reset(seed=self.seed)


@dataclass(frozen=True)
class Search:
    """One episode: whether it ended cleanly, with the target lifted; why not; objects moved, views, times [s]."""

    suite: str
    index: int
    policy: str
    mask_errors: float
    depth_noise: float
    absent: bool
    clean: bool
    lifted: bool
    failure: str
    moves: int
    views: int
    sim_s: float
    cpu_s: float
    belief_s: float
    decision_s: float
    unclean: str = ""
    """What happened that must not: objects fallen or disturbed, furniture pressed."""
    openings: int = 0
    """Drawers and doors opened, or shut again."""
    opens: int = 0
    """Those that there are."""
    mean_decision_s: float = 0.0


def main(arguments: Arguments) -> None:
    """Play what has not been played, and print the table."""
    scenes: tuple[SuiteScene | Drawn, ...] = clutter_env.suite(arguments.suite).test[: arguments.scenes]
    if arguments.layout:
        seeds = range(arguments.first_seed, arguments.first_seed + arguments.scenes)
        scenes = tuple(Drawn(arguments.layout, arguments.objects, seed) for seed in seeds)
    suite, indices = scenes[0].suite, {scene.index for scene in scenes}
    if arguments.perception:
        print(perception_errors(scenes, arguments.depth_noise, arguments.mask_errors))
        return
    if arguments.picture:
        expert, *_ = searched(scenes[-1].make(**_FRAMES), scenes[-1])
        draw_search(expert.report.steps).savefig(arguments.picture, dpi=90)
        return
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    kept = [json.loads(line) for line in arguments.out.read_text().splitlines()] if arguments.out.exists() else []
    rows = [Search(**entry) for entry in kept]
    for scene, policy in product(scenes, arguments.policies):
        wanted = (suite, scene.index, policy, arguments.mask_errors, arguments.depth_noise, arguments.absent)
        if wanted not in [tuple(asdict(row).values())[:6] for row in rows]:
            rows.append(play(scene, *wanted[2:]))
            with arguments.out.open("a") as file:
                file.write(json.dumps(asdict(rows[-1])) + "\n")
    for policy in arguments.policies:
        print(
            summary(
                [
                    row
                    for row in rows
                    if (row.suite, row.policy, row.mask_errors, row.depth_noise, row.absent)
                    == (suite, policy, arguments.mask_errors, arguments.depth_noise, arguments.absent)
                    and row.index in indices
                ]
            )
        )


def searched(
    env: Any, scene: SuiteScene | Drawn, order: str = "expected", noise: float = 0.0, absent: bool = False
) -> tuple[SearchExpert, dict[str, Any], int]:
    """An episode of the search expert: itself, the last info, the number of steps."""
    observation, info = scene.reset(env)
    if absent:
        observation["target"][:3] = _GREY
    expert, steps = SearchExpert(env, order=order, noise=noise), 0
    expert.reset(observation)

    def step(action: Any) -> tuple[Any, ...]:
        observation, reward, terminated, truncated, info = env.step(action)
        return observation, reward, terminated and not absent, truncated, info

    for taken in played(expert, step, observation):
        info, steps = taken.info, steps + 1
    return expert, info, steps


def play(scene: SuiteScene | Drawn, policy: str, mask_errors: float, depth_noise: float, absent: bool) -> Search:
    """One episode of a scene, by a policy."""
    env: Any = scene.make(mask_errors=mask_errors, depth_noise=depth_noise, **_FRAMES)
    started, steps = time.process_time(), 0
    if policy == "all-knowing":
        _, info = scene.reset(env)
        knowing = TampExpert(env, config=ExpertConfig(planning_s=math.inf))  # figures of a loaded machine, too
        knowing.reset(info["target"])
        for taken in played(knowing, env.step):
            info, steps = taken.info, steps + 1
        report, opened = knowing.report, int(info.get("num_opened", 0))
        counts = (report.failure, len(report.clearances), 0)
        times, mean = (0.0, report.planning_s), report.planning_s
    else:
        expert, info, steps = searched(env, scene, policy, depth_noise, absent)
        found, opened = expert.report, len(expert.report.openings)
        counts = ("" if info["lifted"] and not absent else found.failure, len(found.moves), found.views)
        times = max(found.belief_s, default=0.0), max(found.decision_s, default=0.0)
        mean = float(np.mean(found.decision_s or [0.0]))
    env.close()
    faults = {"fallen": info["num_fallen"], "disturbed": info["num_disturbed"], "force": not env.unwrapped.is_gentle}
    return Search(
        scene.suite, scene.index, policy, mask_errors, depth_noise, absent, info["is_success"], info["lifted"],
        *counts, steps / 20, time.process_time() - started, *times, " ".join(name for name in faults if faults[name]),
        opened, len(info.get("joint_positions", ())), mean,
    )  # fmt: skip


def summary(rows: list[Search]) -> str:
    """A line of the table."""
    rate = wilson(sum(row.clean for row in rows), len(rows))
    ends = sum(row.failure == "cannot be found" for row in rows)
    return (
        f"| {rows[0].policy} | {len(rows)} | {rate.mean:.0%} [{rate.low:.0%}, {rate.high:.0%}] | "
        f"{sum(row.lifted for row in rows)} | {ends} | {sum(row.moves for row in rows)} | "
        f"{np.median([row.sim_s for row in rows]):.0f} s | {np.median([row.cpu_s for row in rows]):.1f} s | "
        f"{1000 * max(row.belief_s for row in rows):.0f} ms | {max(row.decision_s for row in rows):.1f} s |"
        f"{_opened(rows) if rows[0].opens else ''}"
    )


def _opened(rows: list[Search]) -> str:
    """Openings, beside the fewest that any order needs in expectation where the target is as likely behind each."""
    fewest = sum((row.opens + 1) / 2 for row in rows)
    decision = np.mean([row.mean_decision_s for row in rows])
    return f" {sum(row.openings for row in rows)} openings, {fewest:.0f} expected | {decision:.2f} s a decision |"


def perception_errors(scenes: tuple[SuiteScene | Drawn, ...], depth_noise: float, mask_errors: float) -> str:
    """Errors of the objects perceived in the first view of each scene, the arm turned aside."""
    errors: list[tuple[float, ...]] = []
    for scene in scenes:
        env: Any = scene.make(depth_noise=depth_noise, mask_errors=mask_errors, **_FRAMES).unwrapped
        observation, _ = env.reset(seed=scene.seed)
        target = env.world.controller.state.target.copy()
        target[4] += 0.6
        for _ in range(30):
            observation, *_ = env.step(env.joint_action(target, 0.1))
        data = mujoco.MjData(env.workplace)
        mujoco.mj_forward(env.workplace, data)
        empty = Scene.from_mujoco(env.workplace, data, env.robot, movable=())
        supports = [empty.support_named(name) for name in empty.supports]
        view = View.of(observation, "head", RobotReading.of(observation).T_world_base)
        true = env.world.scene
        for seen in perceive(view, (), supports, Description.of(observation["target"])):
            away = np.hypot(*(true.positions - seen.body.position[:2]).T)
            nearest = int(away.argmin())
            sizes = np.sort(seen.body.half_extents[:2]) - np.sort(true.half_extents[nearest, :2])
            is_right = (seen.body.shape == "box") == true.is_box[nearest]
            errors.append((float(away.min()), float(np.abs(sizes).max()), float(is_right), seen.sigma))
        env.close()
    place, size, right, sigma = np.array(errors).T
    return (
        f"{len(errors)} objects: place {1000 * np.median(place):.1f} mm (95%: {1000 * np.quantile(place, 0.95):.1f}, "
        f"largest {1000 * place.max():.1f}), half extents {1000 * np.median(size):.1f} mm "
        f"(95%: {1000 * np.quantile(size, 0.95):.1f}), shape right {right.mean():.0%}, "
        f"within two expected standard deviations {(place < 2 * sigma).mean():.0%}"
    )


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
