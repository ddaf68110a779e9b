"""One episode of the expert in the simulation: find a scene, plan, execute, draw, and put the results into words."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from matplotlib.figure import Figure

import clutter_env
from clutter_env.errors import RenderingUnavailable
from clutter_env.experiments.episodes.text import plan_text, replanning_text, report_rows, report_text
from clutter_env.rendering.film import Film
from clutter_env.reporting.progress import progress_bar, shown_compilation
from planners.drawing.page.live import LivePage
from planners.drawing.page.page import write_page
from planners.drawing.plan import draw_plan
from planners.expert.expert import TampExpert
from planners.expert.report import EpisodeReport, Recording
from planners.planner import Planner, warmup
from planners.scene import Scene
from planners.tamp.solution import Infeasible, Solution

__all__ = ["EpisodeResult", "EpisodeSettings", "draw_episode", "episode_figures", "episode_text", "play_episode"]

assert clutter_env  # registers the environments

_MOST_SEEDS = 1000
"""Seeds tried until the target of a scene is obstructed."""
PLANNING_S = 30.0
"""[s] of wall time for one solve."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class EpisodeSettings:
    """What to play.

    Attributes:
        environment: id of a Retrieve environment.
        seed: of the scene; the first seed tried if the target must be obstructed.
        strategy: name of the strategy.
        layout: name of the layout.
        control_mode: "joint" or "ee".
        is_obstructed: take the first seed whose target no level grasp reaches before something is cleared.
        display: "viewer" (a window in real time, which the user closes), "live" (a page on this machine, real time),
            "film" (if the machine can render) or "none".
        grasps: name of the planner's grasp set.
        robot: its name.
    """

    environment: str
    seed: int = 0
    strategy: str = "lookahead"
    layout: str = "paper"
    control_mode: Literal["joint", "ee"] = "joint"
    is_obstructed: bool = True
    display: Literal["viewer", "live", "film", "none"] = "film"
    grasps: str = "side"
    robot: str = "fetch"


@dataclass(frozen=True, eq=False)
class EpisodeResult:
    """An episode that has been played.

    Attributes:
        settings: what was asked for.
        seed: of the scene.
        scene: at the start.
        plan: the first plan, or the reason why there is none.
        report: of the expert.
        is_success: clean success, as the environment says.
        lifted: whether the target was lifted, whatever else moved.
        film: the pictures taken, None if there are none.
        recording: states and plans, for a page in a browser.
    """

    settings: EpisodeSettings
    seed: int
    scene: Scene
    plan: Solution | Infeasible
    report: EpisodeReport
    is_success: bool
    lifted: bool
    film: Film | None
    recording: Recording


def play_episode(settings: EpisodeSettings, say: Say) -> EpisodeResult:
    """Find the scene, plan, and execute until the episode ends; `say` gets messages about the progress.

    Raises:
        ValueError: no seed has an obstructed target.
    """
    env = _make_environment(settings)
    inner: Any = env.unwrapped
    say("loading the planner; its first run on a machine compiles kernels, which takes about a minute")
    started = time.perf_counter()
    with shown_compilation():
        warmup(inner.robot)
    seed, scene, target = _find_scene(settings, env)
    say(f"ready after {time.perf_counter() - started:.0f} s\n")
    where = f"{settings.environment}, robot {settings.robot}, layout {settings.layout}, grasp set {settings.grasps}"
    say(f"{where}, seed {seed}: take {target} out of {len(scene.objects)} objects")
    film = _make_film(settings, env, say)
    expert = TampExpert(env, settings.strategy, grasps=settings.grasps)
    expert.reset(target)
    plan = expert.solution
    if plan is None:
        raise ValueError(expert.report.failure)
    page = _serve(settings, expert, say)
    is_success, lifted = _execute(env, expert, film, page)
    report, recording = expert.report, expert.recording
    if settings.display == "viewer":
        say("the episode is over; close the window to go on")
        inner.wait_for_window()
    env.close()
    result = EpisodeResult(settings, seed, scene, plan, report, is_success, lifted, film, recording)
    if page is not None:
        page.finish(recording, _report_rows(result), _result(result))
        page.close()
    return result


def draw_episode(result: EpisodeResult, directory: Path, html: Path | None = None) -> list[Path]:
    """Write the page, the plan and its pictures, and the film if there is one; the files written.

    Args:
        result: of the episode.
        directory: of the files.
        html: the page; episode.html in the directory if not given.
    """
    files = [directory / "episode.html" if html is None else html]
    write_page(files[0], result.recording, _report_rows(result), _result(result))
    if isinstance(result.plan, Solution) and result.plan.actions:
        pictures = [directory / "plan.png", directory / "overview.png", directory / "plan.npz"]
        files += pictures
        draw_plan(result.plan, pictures[0])
        figure = Figure(figsize=(6.4, 7.2), layout="constrained")
        result.plan.plot(figure.subplots())
        figure.savefig(pictures[1], dpi=130)
        result.plan.save(pictures[2])
    if result.film is not None:
        files.append(directory / "strip.png")
        result.film.save_strip(files[-1])
        files.append(result.film.save_film(directory / "film"))
        result.film.close()
    return files


def episode_text(result: EpisodeResult) -> str:
    """Summary, plan (Fig. 13 of Lee & Kim 2019), replanning (Fig. 11) and report."""
    plan, settings = result.plan, result.settings
    name = settings.strategy
    parts = [plan.summary()]
    if isinstance(plan, Solution):
        parts.append(f"The plan of {name} (as in Fig. 13)\n\n{plan_text(plan, settings.robot)}")
    history = plan.stats.history
    if not history and name != "ngr":
        planner = Planner(result.scene.robot, grasps=settings.grasps)
        ngr = planner.solve(result.scene, plan.target, "ngr", np.random.default_rng(0), PLANNING_S)
        history = ngr.stats.history
        end = f"clears {len(ngr.clearances)}" if isinstance(ngr, Solution) else f"fails: {ngr.cause}"
        parts.append(
            f"{name} needed no replanning. For comparison, ngr, the strategy of Lee & Kim 2019, on the same scene:\n"
            f"ngr replans {len(history)} times and {end}; {name} cleared {len(result.report.clearances)}."
        )
        name = "ngr"
    parts.append(f"Replanning of {name} (as in Fig. 11)\n\n{replanning_text(history) or 'none'}")
    parts.append(
        f"Report, grasp set {settings.grasps}\n\n{report_text(result.report, result.is_success, result.lifted)}"
    )
    return "\n\n".join(parts)


def episode_figures(result: EpisodeResult) -> dict[str, Any]:
    """The results as JSON values."""
    return {
        "environment": result.settings.environment,
        "robot": result.settings.robot,
        "seed": result.seed,
        "target": result.plan.target,
        "strategy": result.settings.strategy,
        "grasps": result.settings.grasps,
        "is_success": result.is_success,
        "lifted": result.lifted,
        "report": asdict(result.report),
        "plan": [str(action) for action in getattr(result.plan, "actions", ())],
        "replanning": [asdict(entry) for entry in result.plan.stats.history],
    }


def _make_environment(settings: EpisodeSettings) -> gym.Env:
    return gym.make(
        settings.environment,
        robot=settings.robot,
        layout=settings.layout,
        control_mode=settings.control_mode,
        render_mode={"viewer": "human", "film": "rgb_array"}.get(settings.display),
        disable_env_checker=True,
    )


def _find_scene(settings: EpisodeSettings, env: gym.Env) -> tuple[int, Scene, str]:
    """Reset to the scene wanted: its seed, its state, and the target."""
    inner: Any = env.unwrapped
    planner = Planner(inner.robot, grasps="side")
    for seed in range(settings.seed, settings.seed + _MOST_SEEDS):
        _, info = env.reset(seed=seed)
        scene = Scene.from_mujoco(inner.model, inner.data, inner.robot)
        if not settings.is_obstructed or planner.clearance_floor(scene, info["target"]).count:
            return seed, scene, info["target"]
    raise ValueError(f"none of the seeds from {settings.seed} to {seed} has an obstructed target; try --no-obstructed")


def _make_film(settings: EpisodeSettings, env: gym.Env, say: Say) -> Film | None:
    """A film, if wanted and possible."""
    if settings.display != "film":
        return None
    try:
        return Film(env.unwrapped)
    except RenderingUnavailable as problem:
        say(f"no film: {problem}")
        return None


def _serve(settings: EpisodeSettings, expert: TampExpert, say: Say) -> LivePage | None:
    """A page on this machine that shows the episode, if wanted."""
    if settings.display != "live":
        return None
    page = LivePage(expert.recording)
    say(f"the episode in a browser of this machine: {page.address}")
    return page


def _result(result: EpisodeResult) -> str:
    return "success" if result.is_success else "failure"


def _report_rows(result: EpisodeResult) -> dict[str, str]:
    """What the page says of the episode."""
    settings = result.settings
    return {
        "environment": settings.environment,
        "robot": settings.robot,
        "seed": str(result.seed),
        "layout": settings.layout,
        "grasp set": settings.grasps,
        **report_rows(result.report, result.is_success, result.lifted),
    }


def _execute(env: gym.Env, expert: TampExpert, film: Film | None, page: LivePage | None) -> tuple[bool, bool]:
    """Let the expert act until the episode ends; whether the environment says success, and whether lifted."""
    is_success = lifted = False
    is_over = expert.done
    step_s = 1 / env.metadata["render_fps"]
    with progress_bar(bar_format="{n:.0f} s simulated{postfix}") as bar:
        while not is_over:
            action = expert.act()
            phase = expert.phase
            _, _, terminated, truncated, info = env.step(action)
            is_success = bool(info["is_success"])
            lifted |= info["lifted"]
            if film is not None:
                film.watch(phase)
            if page is not None:
                page.update(expert.recording)
                time.sleep(step_s)
            bar.update(step_s)
            bar.set_postfix_str(phase, refresh=False)
            is_over = terminated or truncated or expert.done
    if film is not None:
        film.finish(f"{expert.target} taken" if is_success else f"ended: {expert.report.failure}")
    return is_success, lifted
