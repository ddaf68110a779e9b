"""Play one episode of a policy, to look at: in a window, or as a film on a machine without a display.

    clutter-env play --policy keyframes --objects 15
    clutter-env play --policy my_policy:MyPolicy --objects 5 --film outputs/play

"keyframes" is a trained policy that comes with the package.

    clutter-env play --human --suite deep-15-v2

With --human you play yourself, in a browser of this machine: click an object to take it, then a place to put it. The
planner moves the arm, but clears nothing for you. The episode is written as a results file, which `clutter-env verify`
confirms, and as a demonstration if it is a clean success.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class Arguments:
    """Play one episode of a policy."""

    policy: str = "keyframes"
    """A name as for `clutter-env evaluate`, whose help lists them, or module:Class."""
    objects: int = 15
    """Number of objects on the table, the target among them."""
    seed: int = 1_000_000
    """Random seed of the scene. Scenes from 1,000,000 on are never used for training."""
    layout: str = ""
    """Table and surroundings. Empty for the paper's table alone."""
    obstructed: bool = True
    """Only targets that no side grasp reaches before another object moves."""
    trust: bool = False
    """Load models of Stable-Baselines3 (ALGORITHM:FILE.zip), which executes code that is in the file."""
    python: str = ""
    """For lerobot:DIRECTORY: the interpreter of an environment in which LeRobot is installed."""
    film: Path | None = None
    """Write a film to this file, its ending is added. By default a window, or on a machine without a display a film in
    outputs/play."""
    human: bool = False
    """Play yourself, in a browser of this machine. The options below are for this."""
    suite: str = ""
    """Play scenes of a suite, from its first one on. By default scenes of --objects, --layout and --seed."""
    scenes: int = 1
    """Number of scenes, one after the other."""
    grasps: Literal["side", "all"] = "side"
    """The grasps of your moves, and those that the proved minimum is for: level side grasps, or all."""
    port: int = 0
    """Port of the page on 127.0.0.1, 0 for a free one."""
    speed: float = 3.0
    """Simulated time per time, 0 for as fast as the machine can."""
    json: Path | None = None
    """The results file. By default one in outputs/human."""


def run(arguments: Arguments) -> None:
    """Play, and say how it ended."""
    if arguments.human:
        _run_human(arguments)
        return
    from contextlib import closing
    from typing import Any

    import clutter_env
    from clutter_env.errors import UsageError
    from clutter_env.evaluation.recording import Recording
    from clutter_env.evaluation.scenes import SeededScene, scene_for
    from clutter_env.evaluation.score import play_scene
    from clutter_env.policies.experts import PLANNERS
    from clutter_env.policies.registry import PolicyTraits, load_policy
    from clutter_env.rendering.film import Film
    from clutter_env.rendering.renderer import has_display
    from clutter_env.reporting.progress import progress_bar, shown_compilation
    from planners.warming import logged_compilation

    if arguments.objects not in clutter_env.OBJECT_COUNTS:
        valid = ", ".join(map(str, clutter_env.OBJECT_COUNTS))
        raise UsageError(f"--objects {arguments.objects} is not valid; valid numbers: {valid}")
    env_id, path = f"clutter_env/Retrieve-o{arguments.objects}-v0", arguments.film
    if path is None and not has_display():
        policy_name = arguments.policy.replace(":", ".").replace("/", ".")
        path = Path("outputs/play") / f"{policy_name}-{arguments.objects}-{arguments.seed}"
    keywords = {"layout": arguments.layout, "obstructed": arguments.obstructed}
    scene: Any = SeededScene(env_id, {name: value for name, value in keywords.items() if value}, arguments.seed)
    policy = load_policy(arguments.policy, seed=0, trust=arguments.trust, python=arguments.python)
    traits = PolicyTraits.of(policy)
    env = scene.make(render_mode="human" if path is None else "rgb_array", **traits.env_keywords)
    film: Film | None = None
    if arguments.policy in PLANNERS or traits.acts_by_skills:
        from planners import warmup

        with shown_compilation():
            warmup(env.unwrapped.robot)

    def watch(env: Any, policy: Any) -> None:
        nonlocal film
        if path is not None:
            film = film or Film(env.unwrapped)
            film.watch(str(getattr(policy, "phase", "")))
        bar.update(1 / env.metadata["render_fps"])

    # Other policies may use kernels too, and compile them at their first step.
    with logged_compilation(), progress_bar(bar_format="{n:.0f} s simulated, {elapsed} passed") as bar:
        if traits.acts_by_skills:  # a step is a whole skill, whose motions are shown afterwards
            played = scene_for(scene, acts_by_skills=True, feasibility="oracle")
            with closing(played.make()) as skills_env:
                recording = Recording.of(scene, skills_env, play_scene(played, skills_env, policy))
            score = recording.replay(scene, env, watch)
        else:
            score = play_scene(scene, env, policy, watch=watch)
    if path is None:
        env.get_wrapper_attr("wait_for_window")()
    lifted = "the target was lifted" if score.lifted else f"the target was not lifted ({score.failure})"
    around = f"{score.disturbed} objects disturbed, {score.fallen} fallen"
    print(f"{lifted} after {score.sim_s:.1f} s; {around}: {'clean success' if score.clean else 'no clean success'}")
    if path is not None and film is not None:
        film.finish("lifted" if score.lifted else "not lifted")
        path.parent.mkdir(parents=True, exist_ok=True)
        print(f"film: {film.save_film(path)}")
        film.close()
    env.close()


def _run_human(arguments: Arguments) -> None:
    """Let a person play, and say what was written."""
    from clutter_env.cli.play_by_hand import play_by_hand
    from clutter_env.errors import UsageError
    from clutter_env.evaluation.scenes import SceneSet

    if arguments.speed < 0:
        raise UsageError(f"--speed {arguments.speed} is not valid; it must be at least 0")
    if arguments.suite:
        scenes = SceneSet(arguments.suite, count=arguments.scenes)
    else:
        scenes = SceneSet(
            env_id=f"clutter_env/Retrieve-o{arguments.objects}-v0",
            obstructed=arguments.obstructed,
            layout=arguments.layout,
            count=arguments.scenes,
            first_seed=arguments.seed,
        )
    name = arguments.suite or f"o{arguments.objects}_{arguments.seed}"
    file = arguments.json or Path("outputs/human") / f"{name}.json"
    played = play_by_hand(
        scenes,
        grasps=arguments.grasps,
        port=arguments.port,
        speed=arguments.speed,
        json_file=file,
        folder=file.with_suffix(""),
    )
    for path in played.demonstrations:
        print(f"demonstration: {path}")
    print(f"results: {file}; confirm them with: clutter-env verify {file}")
