"""Episodes of the expert in physics behind `clutter-env episode`: one shown in full, or many counted."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack, closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

import gymnasium as gym
from matplotlib.figure import Figure

import clutter_env
from clutter_env.cli import table, table_arguments
from clutter_env.cli.clearance_trials import Trials, let_act
from clutter_env.cli.episode_arguments import Arguments
from clutter_env.errors import RenderingUnavailable, UsageError
from clutter_env.rendering.film import Film
from clutter_env.reporting.progress import progress_bar, shown_compilation
from clutter_env.scene.layout import find_layout
from planners import EpisodeReport, GroundAction, Infeasible, Planner, Scene, Solution, TampExpert, format_plan, warmup

assert clutter_env  # registers the environments

_MOST_SEEDS = 1000
"""Seeds tried until the target of a scene is obstructed."""
_PLANNING_S = 30.0
"""[s] of wall time for one solve."""
_OF_TABLE = ("obstructed", "seed", "robot", "layout", "grasps", "control_mode", "workers", "out")
"""Arguments that `clutter-env table` has too."""
_FACTS = 8
"""Maximum number of new facts printed for one replanning step."""


def show_one(arguments: Arguments) -> dict[str, Any]:
    """Find a scene, plan, execute, draw, and print one episode. Return the results as JSON values.

    Raises:
        UsageError: no seed has an obstructed target, or planning in the scene is impossible.
    """
    mode = {"viewer": "human", "film": "rgb_array"}.get(arguments.display)
    task: dict[str, Any] = {"task": arguments.task} if arguments.task else {}
    keywords = {name: getattr(arguments, name) for name in ("robot", "layout", "control_mode")}
    if find_layout(arguments.layout).opens:
        task["max_episode_steps"] = clutter_env.time_limit(arguments.objects) + clutter_env.OPEN_TIME_LIMIT
    env = gym.make(arguments.environment, render_mode=mode, disable_env_checker=True, **keywords, **task)
    inner: Any = env.unwrapped
    _log("loading the planner; its first run on a machine compiles kernels, which takes about a minute")
    started = time.perf_counter()
    with shown_compilation():
        warmup(inner.robot)
    seed, goal = _find_scene(arguments, env)
    _log(f"ready after {time.perf_counter() - started:.0f} s\n")
    where = f"{arguments.environment}, robot {arguments.robot}, layout {arguments.layout}, grasp set {arguments.grasps}"
    _log(f"{where}, seed {seed}: {goal if arguments.task else f'take {goal} out of {arguments.objects} objects'}")
    expert = TampExpert(env, arguments.strategy, grasps=arguments.grasps)
    with ExitStack() as stack:
        film = film_of(inner, stack) if arguments.display == "film" else None
        expert.reset(goal)
        plan = expert.solution
        if plan is None:
            raise UsageError(expert.report.failure)
        is_success, lifted = _execute(arguments, env, expert, film)
        if arguments.viewer:
            _log("the episode is over; close the window to go on")
            inner.wait_for_window()
        rows = report_rows(expert.report, is_success, lifted)
        files = [arguments.html or arguments.out / "episode.html"]
        about = {name: str(getattr(arguments, name)) for name in ("environment", "robot", "layout")}
        about |= {"seed": str(seed), "grasp set": arguments.grasps}
        expert.to_html(files[0], about | rows, "success" if is_success else "failure")
        if isinstance(plan, Solution) and plan.actions:
            files += write_plan(plan, arguments.out)
        if film is not None:
            files += saved_film(film, arguments.out)
    env.close()
    print(f"\n{episode_text(arguments, plan, rows)}")
    print("\nPlan, pictures and film\n" + "\n".join(f"  {path}" for path in files))
    return {
        **{name: getattr(arguments, name) for name in ("environment", "robot", "strategy", "grasps")},
        "seed": seed,
        "target": plan.target,
        "goal": goal,
        "is_success": is_success,
        "lifted": lifted,
        "report": asdict(expert.report),
        "plan": [str(action) for action in getattr(plan, "actions", ())],
        "replanning": [asdict(entry) for entry in plan.stats.history],
        "files": list(map(str, files)),
    }


def film_of(inner: Any, stack: ExitStack) -> Film | None:
    """The film of an environment, closed with the stack. None, after a message, if the machine cannot render."""
    try:
        return stack.enter_context(closing(Film(inner)))
    except RenderingUnavailable as problem:
        _log(f"no film: {problem}")
        return None


def saved_film(film: Film, out: Path) -> list[Path]:
    """Save the strip and the film in a directory. Return the files."""
    film.save_strip(out / "strip.png")
    return [out / "strip.png", film.save_film(out / "film")]


def _log(text: str) -> None:
    print(text, flush=True)


def _find_scene(arguments: Arguments, env: gym.Env) -> tuple[int, str]:
    """Reset to the requested scene: its seed, and the target's name, or the goal of a task as PDDL."""
    inner: Any = env.unwrapped
    planner = Planner(inner.robot, grasps="side")
    for seed in range(arguments.seed, arguments.seed + _MOST_SEEDS):
        _, info = env.reset(seed=seed)
        # Where something is shut, no grasp reaches a target: it is obstructed in every scene.
        if arguments.task or not arguments.obstructed or find_layout(arguments.layout).opens:
            return seed, info["goal"] if arguments.task else info["target"]
        scene = Scene.from_mujoco(inner.model, inner.data, inner.robot)
        if planner.clearance_floor(scene, info["target"]).count:
            return seed, info["target"]
    raise UsageError(f"none of the seeds from {arguments.seed} to {seed} has an obstructed target; try --no-obstructed")


def _execute(arguments: Arguments, env: gym.Env, expert: TampExpert, film: Film | None) -> tuple[bool, bool]:
    """Let the expert act until the episode ends. Return the environment's success, and whether the target was
    lifted."""
    page = expert.live_page() if arguments.display == "live" else None
    if page is not None:
        _log(f"the episode in a browser of this machine: {page.address}")
    step_s = 1 / env.metadata["render_fps"]
    with progress_bar(bar_format="{n:.0f} s simulated{postfix}") as bar:

        def watch(phase: str) -> None:
            if film is not None:
                film.watch(phase)
            if page is not None:
                page.update(expert.recording)
                time.sleep(step_s)
            bar.update(step_s)
            bar.set_postfix_str(phase, refresh=False)

        info, lifted = let_act(expert, env, watch)
    is_success = bool(info["is_success"])
    if film is not None:
        done = f"{expert.target} taken" if expert.target else "goal reached"
        film.finish(done if is_success else f"ended: {expert.report.failure}")
    if page is not None:
        result = "success" if is_success else "failure"
        page.finish(expert.recording, report_rows(expert.report, is_success, lifted), result)
        page.close()
    return is_success, lifted


def write_plan(plan: Solution, out: Path) -> list[Path]:
    """Write the pictures of a plan's clearances, if it has any, its overview and the plan itself. Return the files."""
    files = [out / "overview.png", out / "plan.npz"]
    if plan.target or any(action.surfaces for action in plan.actions):
        plan.plot_clearances(out / "plan.png")
        files.insert(0, out / "plan.png")
    figure = Figure(figsize=(6.4, 7.2), layout="constrained")
    plan.plot(figure.subplots())
    figure.savefig(out / "overview.png", dpi=130)
    plan.save(out / "plan.npz")
    return files


def episode_text(arguments: Arguments, plan: Solution | Infeasible, rows: Mapping[str, str]) -> str:
    """Summary, plan (Fig. 13 of Lee & Kim 2019), replanning (Fig. 11) and the rows of the report."""
    parts, name = [plan.summary()], arguments.strategy
    if isinstance(plan, Solution):
        parts.append(f"The plan of {name} (as in Fig. 13)\n\n{plan_text(plan, arguments.robot)}")
    parts.append(f"Replanning of {name} (as in Fig. 11)\n\n{replanning_text(plan) or 'none'}")
    width = max(map(len, rows))
    report = "\n".join(f"  {name:<{width}}  {value}" for name, value in rows.items())
    parts.append(f"Report, grasp set {arguments.grasps}\n\n{report}")
    return "\n\n".join(parts)


def plan_text(solution: Solution, robot: str = "fetch") -> str:
    """The plan F as the paper prints it, one action a line, with the robot's name."""
    by = f" (obstructed by {', '.join(solution.clearances)})" if solution.clearances else ""
    actions = (GroundAction(action.name, action.args) for action in solution.actions)
    goal = f"grasp the {solution.target}{by}" if solution.target else str(solution.goal)
    return f"Goal: {goal}\n\n{format_plan(actions, robot)}"


def replanning_text(outcome: Solution | Infeasible) -> str:
    """For each task plan: its actions, the verified ones (+), the refuted action (x), and the facts learnt from it."""
    parts = []
    for number, entry in enumerate(outcome.stats.history, start=1):
        lines = [f"Task plan {number}"]
        for index, action in enumerate(entry.plan):
            mark = "+" if index < entry.verified else "x" if index == entry.verified else " "
            lines.append(f"  {mark} {action}")
        lines.append("  refuted; new facts in the initial state:" if entry.new_facts else "  refuted")
        lines += [f"    {fact}" for fact in entry.new_facts[:_FACTS]]
        if len(entry.new_facts) > _FACTS:
            lines.append(f"    ... and {len(entry.new_facts) - _FACTS} more")
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def report_rows(report: EpisodeReport, is_success: bool, lifted: bool) -> dict[str, str]:
    """The results of the episode by name. `is_success` and `lifted` are those of the environment."""
    reason = "an object has fallen or been disturbed" if lifted else "the goal was not reached"
    return {
        "success": "yes, by the environment" if is_success else f"no: {report.failure or reason}",
        "target lifted, or goal reached": "yes" if lifted else "no",
        **report.rows(),
    }


def count_many(arguments: Arguments) -> dict[str, Any]:
    """Play the scenes from a seed on in parallel, as `clutter-env table` does, and print its tables. Return the
    episodes."""
    chosen = table_arguments.Arguments(
        objects=(arguments.objects,),
        strategies=(arguments.strategy,),
        scenes=arguments.episodes,
        physics=True,
        time_limit=_PLANNING_S,
        **{name: getattr(arguments, name) for name in _OF_TABLE},
    )
    (arguments.out / "trials.jsonl").unlink(missing_ok=True)
    table.run(chosen)
    trials = Trials(chosen)
    floors = trials.floors(arguments.objects)
    attempts = trials.attempts(arguments.objects, arguments.strategy)
    episodes = [{"floor": floors.get(seed), "attempt": asdict(attempt)} for seed, attempt in attempts.items()]
    return {"settings": trials.settings, "episodes": episodes}
