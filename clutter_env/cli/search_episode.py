"""One search for a hidden target behind `clutter-env episode --task search`, shown in full."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import gymnasium as gym

import clutter_env
from clutter_env.cli.episode_arguments import Arguments
from clutter_env.cli.expert_episodes import film_of, saved_film
from clutter_env.policies.playing import played
from clutter_env.rendering.film import LOOKING
from clutter_env.reporting.progress import progress_bar, shown_compilation
from planners import SearchExpert, warmup
from planners.drawing.page.page import write_page
from planners.drawing.pictures import draw_search
from planners.expert.report import Recorder

assert clutter_env  # registers the environments

_FRAME_EVERY = 10
"""Control steps between images: the expert looks only while the robot rests."""


def show_search(arguments: Arguments) -> dict[str, Any]:
    """Play a scene by camera data alone, film it, draw the belief and print the report. Return the figures."""
    keywords: dict[str, Any] = {name: getattr(arguments, name) for name in ("robot", "layout", "control_mode")}
    env = gym.make(arguments.environment, frame_every=_FRAME_EVERY, disable_env_checker=True, **keywords)
    inner: Any = env.unwrapped
    with shown_compilation():
        warmup(inner.robot)
    observation, info = env.reset(seed=arguments.seed)
    expert = SearchExpert(env)
    expert.reset(observation)
    recorder = Recorder(inner, info["target"])
    recorder.add_solve(expert.report)
    with ExitStack() as stack:
        film = film_of(inner, stack) if arguments.film else None
        bar = stack.enter_context(progress_bar(bar_format="{n:.0f} s simulated{postfix}"))

        def step(action: Any) -> tuple[Any, ...]:
            recorder.add_frame(len(expert.report.steps) - 1, expert.phase or LOOKING)
            return env.step(action)

        for taken in played(expert, step, observation):
            info = taken.info
            bar.update(1 / env.metadata["render_fps"])
            if film is not None:
                film.watch(expert.phase or LOOKING)
        report, is_success = expert.report, bool(info["is_success"])
        rows = {
            "success": "yes, by the environment" if is_success else f"no: {report.failure or 'not clean'}",
            "target found, lifted": f"{'yes' if report.found else 'no'}, {'yes' if info['lifted'] else 'no'}",
            "other views": str(report.views),
            "objects put aside": str(len(report.moves)),
            "deviations": "; ".join(report.deviations) or "none",
            "slowest decision": f"{max(report.decision_s, default=0.0):.1f} s of CPU time",
        }
        files = [arguments.html or arguments.out / "episode.html", arguments.out / "search.png"]
        write_page(files[0], recorder.recording(), rows, "success" if is_success else "failure")
        draw_search(report.steps).savefig(files[1], dpi=110)
        if film is not None:
            film.finish("target taken" if is_success else f"ended: {rows['success']}")
            files += saved_film(film, arguments.out)
    env.close()
    decisions = [f"{step.time:.0f} s: {step.text}" for step in report.steps]
    print("\n".join([f"Decisions, seed {arguments.seed}", *decisions, "", *(f"{name}: {rows[name]}" for name in rows)]))
    print("\nPage, pictures and film\n" + "\n".join(f"  {path}" for path in files))
    return {
        "environment": arguments.environment,
        "layout": arguments.layout,
        "seed": arguments.seed,
        "is_success": is_success,
        "lifted": bool(info["lifted"]),
        "decisions": decisions,
        "moves": report.moves,
        "failure": report.failure,
        "files": list(map(str, files)),
    }
