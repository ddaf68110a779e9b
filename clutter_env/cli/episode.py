"""The expert in physics: one episode shown in full, or many counted.

    python scripts/run_episode.py --objects 15
    python scripts/run_episode.py --objects 40 --episodes 50 --control-mode joint

One episode: the plan (Fig. 13 of Lee & Kim 2019), the replanning (Fig. 11), the report, a picture of every choice of
a clearance location (Figs. 8-10), and where the machine can draw, a film. Many: success and the causes of failure.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from tqdm import tqdm

import clutter_env
from assets.robots import FETCH
from clutter_env.cli.command import run_command
from clutter_env.errors import RenderingUnavailable
from clutter_env.experiments.clearance_table.trials import Trial
from clutter_env.experiments.episodes.many import counts_text, play_many
from clutter_env.experiments.episodes.text import plan_text, replanning_text, report_text
from clutter_env.rendering.film import FRAME_SIZE, Film
from clutter_env.scene.layout import LAYOUTS
from irm.maps.cache import cache_file, cached_map
from planners.drawing.plan import draw_plan
from planners.execution.expert import EpisodeReport, TampExpert
from planners.planner import Planner
from planners.scene import Scene
from planners.strategies import find_strategy
from planners.tamp.solution import Solution

_MOST_SEEDS = 1000
"""Seeds looked at for a scene whose target is obstructed."""
_PLANNING_S = 30.0
"""[s] of wall time for one solve."""


@dataclass(frozen=True)
class Arguments:
    """Run the expert."""

    objects: int = 15
    """Objects on the table, the target among them."""
    seed: int = 0
    """Of the scene."""
    strategy: str = "lookahead"
    """lookahead, ngr (the paper), dogar or srivastava."""
    layout: str = "paper"
    control_mode: Literal["joint", "ee"] = "joint"
    obstructed: bool = True
    """Take the first seed from --seed on whose target cannot be reached before something is cleared."""
    episodes: int = 1
    """With more than one, episodes are counted, not shown."""
    jobs: int = os.cpu_count() or 1
    """Processes for many episodes."""
    viewer: bool = False
    """Open MuJoCo's viewer, in real time."""
    film: bool = True
    """Film the episode where the machine can draw."""
    output: Path = Path("outputs/episode")
    """Directory of the pictures, the film and the figures."""
    json: Path | None = None
    """Write the figures to this file too."""

    def __post_init__(self) -> None:
        find_strategy(self.strategy)
        if self.layout not in LAYOUTS:
            raise ValueError(f"--layout {self.layout} is not valid; valid ones: {', '.join(LAYOUTS)}")
        if self.objects not in clutter_env.OBJECT_COUNTS:
            valid = ", ".join(map(str, clutter_env.OBJECT_COUNTS))
            raise ValueError(f"--objects {self.objects} is not valid; valid numbers: {valid}")

    @property
    def environment(self) -> str:
        """Its id."""
        return f"clutter_env/Retrieve-o{self.objects}-v0"


def run(arguments: Arguments) -> None:
    """One episode or many."""
    get_ready()
    arguments.output.mkdir(parents=True, exist_ok=True)
    figures = show_one(arguments) if arguments.episodes == 1 else count_many(arguments)
    for path in filter(None, (arguments.output / "report.json", arguments.json)):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(figures, indent=1))


def get_ready() -> None:
    """Build what is kept between runs, and say so."""
    if not cache_file(FETCH).exists():
        print(f"building the reachability map, once; it is kept in {cache_file(FETCH).parent}", flush=True)
    cached_map(FETCH, progress=True)


def show_one(arguments: Arguments) -> dict[str, Any]:
    """Play, draw and print one episode; its figures."""
    env = make_environment(arguments)
    print("loading the planner; its first run on a machine compiles kernels, which takes a minute or two", flush=True)
    started = time.perf_counter()
    seed, scene, target = find_scene(arguments, env)
    print(f"ready after {time.perf_counter() - started:.0f} s\n")
    where = f"{arguments.environment}, layout {arguments.layout}, seed {seed}"
    print(f"{where}: take {target} out of {arguments.objects} objects")
    expert = TampExpert(env, arguments.strategy)
    film = make_film(arguments, env)
    report, is_success, plan = play(arguments, env, expert, target, film)
    files = draw(arguments, plan, film)
    env.close()
    show_text(arguments, plan, scene, target, report, is_success)
    print("\nPictures and film\n" + "\n".join(f"  {path}" for path in files))
    return {
        "environment": arguments.environment,
        "seed": seed,
        "target": target,
        "strategy": arguments.strategy,
        "is_success": is_success,
        "report": asdict(report),
        "plan": [str(action) for action in getattr(plan, "actions", ())],
        "replanning": [asdict(entry) for entry in plan.stats.history],
        "files": [str(path) for path in files],
    }


def make_environment(arguments: Arguments) -> gym.Env:
    """The environment, able to draw what is asked for."""
    draws = "human" if arguments.viewer else "rgb_array" if arguments.film else None
    return gym.make(
        arguments.environment,
        layout=arguments.layout,
        control_mode=arguments.control_mode,
        render_mode=draws,
        width=FRAME_SIZE,
        height=FRAME_SIZE,
        disable_env_checker=True,
    )


def find_scene(arguments: Arguments, env: gym.Env) -> tuple[int, Scene, str]:
    """Reset to the scene wanted: its seed, what the planner sees of it, and the target."""
    world: Any = env.unwrapped
    planner = Planner(world.robot)
    for seed in range(arguments.seed, arguments.seed + _MOST_SEEDS):
        _, info = env.reset(seed=seed)
        scene = Scene.from_mujoco(world.model, world.data, world.robot)
        if not arguments.obstructed or planner.clearance_floor(scene, info["target"]).count:
            return seed, scene, info["target"]
    raise ValueError(f"none of the seeds from {arguments.seed} to {seed} has an obstructed target; try --no-obstructed")


def make_film(arguments: Arguments, env: gym.Env) -> Film | None:
    """A film, if wanted and possible."""
    if arguments.viewer or not arguments.film:
        return None
    try:
        return Film(env.unwrapped)
    except RenderingUnavailable as problem:
        print(f"no film: {problem}")
        return None


def play(
    arguments: Arguments, env: gym.Env, expert: TampExpert, target: str, film: Film | None
) -> tuple[EpisodeReport, bool, Any]:
    """Let the expert act until the episode ends: its report, success, and the first plan."""
    expert.reset(target)
    plan = expert.solution
    info: dict[str, Any] = {"is_success": False}
    over = expert.done
    step_s = 1 / env.metadata["render_fps"]
    with tqdm(bar_format="{n:.0f} s simulated{postfix}") as bar:
        while not over:
            action = expert.act()
            phase = expert.phase
            _, _, terminated, truncated, info = env.step(action)
            if film is not None:
                film.watch(phase)
            if arguments.viewer:
                time.sleep(step_s)
            bar.update(step_s)
            bar.set_postfix_str(phase, refresh=False)
            over = terminated or truncated or expert.done
    if film is not None:
        film.finish(f"{target} taken" if info["is_success"] else f"ended: {expert.report.failure}")
    return expert.report, bool(info["is_success"]), plan


def draw(arguments: Arguments, plan: Any, film: Film | None) -> list[Path]:
    """Write the pictures there are to draw."""
    files = []
    if isinstance(plan, Solution) and plan.clearances:
        files.append(arguments.output / "plan.png")
        draw_plan(plan, files[-1])
    if film is not None:
        files.append(arguments.output / "strip.png")
        film.save_strip(files[-1])
        files.append(film.save_film(arguments.output / "film"))
        film.close()
    return files


def show_text(
    arguments: Arguments, plan: Any, scene: Scene, target: str, report: EpisodeReport, is_success: bool
) -> None:
    """Plan, replanning and report."""
    print(f"\nThe plan of {arguments.strategy} (as in Fig. 13)\n\n{plan_text(plan, target)}")
    history, name = plan.stats.history, arguments.strategy
    if not history and name != "ngr":
        print(f"\n{name} knew from the start what obstructs what: the first task plan held. Replanning, as in Fig. 11,")
        print("is what the paper's own strategy needs on the same scene:")
        outcome = Planner(scene.robot).solve(scene, target, "ngr", np.random.default_rng(0), _PLANNING_S)
        history, name = outcome.stats.history, "ngr"
        end = f"clears {len(outcome.clearances)}" if isinstance(outcome, Solution) else f"fails: {outcome.cause}"
        print(f"ngr replans {len(history)} times and {end}; {arguments.strategy} cleared {len(report.clearances)}.")
    print(f"\nReplanning of {name} (as in Fig. 11)\n\n{replanning_text(history) or 'none'}")
    print(f"\nReport\n\n{report_text(report, is_success)}")


def count_many(arguments: Arguments) -> dict[str, Any]:
    """Play many episodes and print what came of them; their records."""
    first = Trial(
        arguments.objects,
        arguments.seed,
        arguments.strategy,
        arguments.layout,
        arguments.control_mode,
        physics=True,
        time_limit=_PLANNING_S,
    )
    path = arguments.output / "episodes.jsonl"
    print(
        f"{arguments.episodes} episodes of {arguments.environment}, {arguments.control_mode} mode, {arguments.strategy}"
    )
    played = play_many(first, arguments.episodes, arguments.obstructed, arguments.jobs, path)
    print(f"\n{counts_text(played)}\n\nevery episode: {path}")
    return {"settings": asdict(first), "episodes": [asdict(episode) for episode in played]}


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("episode", Arguments, run, __doc__, words)
