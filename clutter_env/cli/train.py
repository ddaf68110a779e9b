"""Train a policy, from rewards or from demonstrations, with checkpoints and TensorBoard logs.

    clutter-env train --env clutter_env/Reach-v0 --algorithm sac --steps 30000
    clutter-env train --env clutter_env/Skill-o10-v0 --algorithm maskable_ppo --steps 30000 --seeds 3 --workers 2
    clutter-env train --env clutter_env/Pick-v0 --algorithm bc --steps 10000 --demos outputs/demos/pick
    clutter-env train --env clutter_env/Retrieve-o15-v0 --algorithm keyframes --steps 4000 --demos outputs/demos/o15
    clutter-env train --env clutter_env/Retrieve-o25-v0 --grasps all --algorithm keyframes --steps 6000
    clutter-env train --env clutter_env/Retrieve-o15-v0 --obstructed --algorithm decisions_dagger --steps 3000

Without --out a run is written to a directory of its own under outputs/runs.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from clutter_env.learning.training.run import Run
    from clutter_env.learning.training.training import Trained


@dataclass(frozen=True)
class Arguments:
    """Train a policy."""

    env: str = "clutter_env/Reach-v0"
    """Environment id."""
    algorithm: Literal[
        "sac",
        "tqc",
        "ppo",
        "maskable_ppo",
        "bc",
        "dagger",
        "keyframes",
        "chunks",
        "flow",
        "decisions",
        "decisions_dagger",
    ] = "sac"
    """SAC and TQC (with hindsight) for Reach and Pick, PPO and MaskablePPO for Skill, BC and DAgger for all others. For
    Retrieve: keyframes, chunks and flow clone motions; decisions, and with DAgger, learn what to take and where to put
    it."""
    steps: int = 30_000
    """Steps of the environment; gradient steps of those that clone and of decisions, and of each round of dagger."""
    seed: int = 0
    """Random seed; the first one of several."""
    seeds: int = 1
    """Number of seeds; each is a run of its own, in seed-N/ in the directory."""
    workers: int = 2
    """Number of seeds that are trained at a time."""
    ray: str = ""
    """Address of Ray ("auto", "local", …): train several seeds there instead of in processes of this machine."""
    out: Path | None = None
    """Directory of the run or runs; without it, one in outputs/runs/ named by algorithm, environment and seed."""
    demos: Path | None = None
    """Dataset of `clutter-env collect`: cloned by those that clone; sac and tqc correct the clone. Keyframes without
    a dataset learns from canonical plans of which nothing is simulated."""
    demo_episodes: int | None = None
    """How many of its episodes to use; all by default. Scenes from which decisions collects examples, and that are
    planned for keyframes without a dataset. For ppo and maskable_ppo: scenes whose good skills are cloned first; none
    by default."""
    imitation_steps: int = 10_000
    """Gradient steps of the clone that sac and tqc correct, and that ppo and maskable_ppo improve."""
    control_mode: Literal["joint", "ee", ""] = ""
    """Control mode; empty for the environment's own."""
    reward_mode: Literal["sparse", "dense", ""] = ""
    """Reward mode; empty for the environment's own."""
    simulation: Literal["physics", "kinematic"] = "kinematic"
    """Whether Skill is learnt in physics or on the kinematic model."""
    geometric_mask: bool = False
    """Leave out skills without a free grasp while learning Skill."""
    obstructed: bool = False
    """Learn on scenes whose target no side grasp reaches without moving something."""
    feasibility: Literal["oracle", "none"] = "oracle"
    """Whether Skill refuses skills without a free grasp, or tries them all the same."""
    layout: str = ""
    """Table and surroundings, for decisions and keyframes; empty for the environment's own."""
    grasps: Literal["side", "tilted", "top", "all"] = "side"
    """Grasps that decisions are made among, and those of plans that keyframes learns from."""
    rounds: int = 5
    """Rounds of dagger and of decisions_dagger."""
    round_episodes: int = 10
    """Episodes of the learner in each round."""
    expert: str = ""
    """Expert that corrects the learner in dagger; empty for the one of the demonstrations."""
    checkpoint_every: int = 5000
    """Steps between checkpoints."""
    evaluation_episodes: int = 20
    """Held-out scenes played at every checkpoint."""
    evaluation_steps: int = 600
    """Steps after which each of them is cut off."""
    resume: bool = False
    """Go on from the last checkpoint; all settings but --steps and --checkpoint-every must be the same."""
    json: Path | None = None
    """Write the histories of all runs to this file."""


def run(arguments: Arguments) -> None:
    """Train and print the histories."""
    from clutter_env.learning.training.seeds import seeds_of, train_all
    from clutter_env.reporting.files import write_json

    runs = seeds_of(make_run(arguments), arguments.seeds)
    trained = train_all(runs, arguments.workers, arguments.resume, arguments.ray, report=print_history)
    if arguments.json is not None:
        write_json(arguments.json, [{**one.describe(), **asdict(end)} for one, end in zip(runs, trained, strict=True)])


def print_history(run: Run, trained: Trained) -> None:
    """Print success at every checkpoint, and the times."""
    for entry in trained.history:
        print("  ".join(f"{name} {value:g}" for name, value in entry.items()))
    print(f"{run.directory}: {trained.wall_s:.0f} s, {trained.cpu_s:.0f} s of CPU time")


def make_run(arguments: Arguments) -> Run:
    """The run that the arguments describe."""
    from clutter_env.learning.task import Task
    from clutter_env.learning.training.run import Run

    chosen = {name: getattr(arguments, name) for name in ("control_mode", "reward_mode", "obstructed", "layout")}
    keywords: dict[str, Any] = {name: value for name, value in chosen.items() if value}
    if "/Skill" in arguments.env:
        keywords |= {name: getattr(arguments, name) for name in ("simulation", "geometric_mask", "feasibility")}
    name = f"{arguments.algorithm}-{arguments.env.rpartition('/')[2].removesuffix('-v0').lower()}"
    if arguments.seeds == 1:
        name += f"-{arguments.seed}"
    return Run(
        task=Task(arguments.env, keywords),
        algorithm=arguments.algorithm,
        steps=arguments.steps,
        directory=arguments.out or Path("outputs/runs") / name,
        seed=arguments.seed,
        demonstrations=arguments.demos,
        episodes=arguments.demo_episodes,
        imitation_steps=arguments.imitation_steps,
        rounds=arguments.rounds,
        round_episodes=arguments.round_episodes,
        expert=arguments.expert,
        checkpoint_every=arguments.checkpoint_every,
        evaluation_episodes=arguments.evaluation_episodes,
        evaluation_steps=arguments.evaluation_steps,
        grasps=arguments.grasps,
    )
