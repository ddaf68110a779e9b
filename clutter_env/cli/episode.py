"""The expert in physics: one episode shown in full, or many counted.

    clutter-env episode --objects 15
    clutter-env episode --robot pr2 --objects 15
    clutter-env episode --objects 40 --episodes 50 --control-mode joint --grasps all

One episode: the plan (Fig. 13 of Lee & Kim 2019), the replanning (Fig. 11), the report, a picture of every choice of
a clearance location (Figs. 8-10), the plan as a file, the episode in 3-D as one page for a browser, and where the
machine can render, a film. Many: the success rate and the causes of failure.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import clutter_env
from assets import robot as find_robot
from clutter_env.experiments.clearance_table.trials import Trial
from clutter_env.experiments.episodes.episode import (
    PLANNING_S,
    EpisodeSettings,
    draw_episode,
    episode_figures,
    episode_text,
    play_episode,
)
from clutter_env.experiments.episodes.many import counts_text, play_many
from clutter_env.reporting.command import run_command
from clutter_env.reporting.files import write_json
from clutter_env.reporting.progress import progress_bar
from clutter_env.scene.layout import LAYOUTS
from irm import cache_folder, cached_map, is_map_at_hand
from planners import find_strategy, map_parameters


@dataclass(frozen=True)
class Arguments:
    """Run the expert."""

    objects: int = 15
    """Number of objects on the table, the target among them."""
    seed: int = 0
    """Random seed of the scene."""
    strategy: str = "lookahead"
    """lookahead, ngr (Lee & Kim 2019), dogar or srivastava."""
    layout: str = "paper"
    """Table and surroundings."""
    robot: str = "fetch"
    """Name of the robot."""
    grasps: Literal["side", "tilted", "top", "all"] = "side"
    """Grasp set: level gripper (the paper's experiment), tilted, from above, or all of them."""
    control_mode: Literal["joint", "ee"] = "joint"
    """Joint targets, or TCP poses."""
    obstructed: bool = True
    """Take the first seed, from --seed on, whose target no level grasp reaches before something is cleared."""
    episodes: int = 1
    """With more than one, episodes are counted, not shown."""
    workers: int = os.cpu_count() or 1
    """Number of processes for many episodes."""
    viewer: bool = False
    """Open MuJoCo's viewer, in real time."""
    live: bool = False
    """Show the running episode in a browser of this machine, in real time; its address is printed."""
    html: Path | None = None
    """The episode as one page for a browser; episode.html in --out if not given."""
    film: bool = True
    """Film the episode if the machine can render."""
    out: Path = Path("outputs/episode")
    """Directory of the pictures, the plan, the film and the figures."""
    json: Path | None = None
    """Write the figures to this file too."""

    def __post_init__(self) -> None:
        find_strategy(self.strategy)
        find_robot(self.robot)
        if self.layout not in LAYOUTS:
            raise ValueError(f"--layout {self.layout} is not valid; valid ones: {', '.join(LAYOUTS)}")
        if self.objects not in clutter_env.OBJECT_COUNTS:
            valid = ", ".join(map(str, clutter_env.OBJECT_COUNTS))
            raise ValueError(f"--objects {self.objects} is not valid; valid numbers: {valid}")

    @property
    def environment(self) -> str:
        """Id of the environment."""
        return f"clutter_env/Retrieve-o{self.objects}-v0"


def run(arguments: Arguments) -> None:
    """Play one episode or many."""
    robot = find_robot(arguments.robot)
    if not is_map_at_hand(robot, **map_parameters(robot)):
        print(f"building the reachability map, once; it is kept in {cache_folder()}", flush=True)
        cached_map(robot, progress=progress_bar, **map_parameters(robot))
    arguments.out.mkdir(parents=True, exist_ok=True)
    figures = show_one(arguments) if arguments.episodes == 1 else count_many(arguments)
    for path in filter(None, (arguments.out / "report.json", arguments.json)):
        write_json(path, figures)


def show_one(arguments: Arguments) -> dict[str, Any]:
    """Play, draw and print one episode; its figures."""
    settings = EpisodeSettings(
        arguments.environment,
        arguments.seed,
        arguments.strategy,
        arguments.layout,
        arguments.control_mode,
        arguments.obstructed,
        "viewer" if arguments.viewer else "live" if arguments.live else "film" if arguments.film else "none",
        arguments.grasps,
        arguments.robot,
    )
    result = play_episode(settings, say=lambda text: print(text, flush=True))
    files = [str(path) for path in draw_episode(result, arguments.out, arguments.html)]
    print(f"\n{episode_text(result)}")
    print("\nPlan, pictures and film\n" + "\n".join(f"  {path}" for path in files))
    return {**episode_figures(result), "files": files}


def count_many(arguments: Arguments) -> dict[str, Any]:
    """Play many episodes and print the success rate; their records."""
    first = Trial(
        arguments.objects,
        arguments.seed,
        arguments.strategy,
        arguments.layout,
        arguments.control_mode,
        physics=True,
        time_limit=PLANNING_S,
        grasps=arguments.grasps,
        robot=arguments.robot,
    )
    path = arguments.out / "episodes.jsonl"
    mode = f"{arguments.control_mode} mode, {arguments.strategy}, grasp set {arguments.grasps}"
    print(f"{arguments.episodes} episodes of {arguments.environment}, robot {arguments.robot}, {mode}")
    played = play_many(first, arguments.episodes, arguments.obstructed, arguments.workers, path)
    print(f"\n{counts_text(played)}\n\nevery episode: {path}")
    return {"settings": asdict(first), "episodes": [asdict(episode) for episode in played]}


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("episode", Arguments, run, __doc__, words)
