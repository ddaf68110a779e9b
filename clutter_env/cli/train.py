"""Train a policy from rewards, by a learner of Stable-Baselines3 or sb3-contrib, or end to end from plans.

    clutter-env train tqc --env clutter_env/ArmReach-v0 --steps 20000
    clutter-env train maskable-ppo --env clutter_env/Skill-o10-v0 --steps 30000 --seeds 3 --workers 2
    clutter-env train end-to-end --scenes 440

SAC and TQC take some 30 ms a step, end-to-end 0.7 s a scene and some five minutes. Learners from rewards write
checkpoints and TensorBoard logs. Without --out a run is written to a directory of its own under outputs/runs.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from clutter_env.training.settings import ALGORITHMS, Settings

if TYPE_CHECKING:
    from clutter_env.training.run import Run
    from clutter_env.training.train import Trained

_ENVIRONMENTS = {
    "reach": "clutter_env/ArmReach-v0",
    "retrieve": "clutter_env/Retrieve-o15-v0",
    "skill": "clutter_env/Skill-o15-v0",
}
"""Environments to learn on if none is given, by the first family that an algorithm is for."""
_KEYWORDS: tuple[str, ...] = ("control_mode", "reward_mode", "layout", "object_set", "obstructed")
_KEYWORDS += ("simulation", "geometric_mask", "feasibility")
"""The arguments that the environment has too."""
WHEN_INTERRUPTED = (
    "run the same command again, with --resume to go on from the last checkpoint; end-to-end reads its plans again"
)


@dataclass(frozen=True)
class Arguments:
    """Train a policy."""

    algorithm: tyro.conf.Positional[Literal["sac", "tqc", "ppo", "maskable-ppo", "dqn", "end-to-end"]]
    """sac, tqc: on ArmReach, ArmPick, Reach, Pick with hindsight (HER), and on Retrieve. ppo: on Retrieve and Skill.
    maskable-ppo, dqn: on Skill. end-to-end: from plans of the planner for Retrieve scenes, without rewards."""
    env: str = ""
    """Environment id. Empty for clutter_env/ArmReach-v0, Retrieve-o15-v0 or Skill-o15-v0, as the algorithm needs."""
    settings: Annotated[Settings, tyro.conf.arg(name="")] = field(default_factory=Settings)
    """Numbers of steps, copies and evaluations."""
    seed: int = 0
    """Random seed, or the first one of several."""
    seeds: int = 1
    """Number of seeds. Each is a run of its own, in seed-N/ in the directory."""
    workers: int = 2
    """Number of seeds that are trained at a time."""
    ray: str = ""
    """Address of Ray ("auto", "local", …): train several seeds there instead of in processes of this machine."""
    out: Path | None = None
    """Directory of the run or runs. By default one in outputs/runs/ named by algorithm, environment and seed."""
    control_mode: Literal["joint", "ee", ""] = ""
    """Control mode. Empty for the environment's own, as below."""
    reward_mode: Literal["sparse", "dense", ""] = ""
    """Reward mode."""
    layout: str = ""
    """Table and surroundings."""
    object_set: str = ""
    """Set of objects, such as "household"."""
    obstructed: bool = False
    """Only scenes whose target no side grasp reaches before another object moves."""
    simulation: Literal["physics", "kinematic", ""] = ""
    """Simulation of Skill. Empty for the kinematic model."""
    geometric_mask: bool = False
    """Leave out skills without a free grasp while learning Skill by maskable-ppo: with 15 objects 0.2 CPU s a step.
    Held-out scenes are played without."""
    feasibility: Literal["oracle", "none", ""] = ""
    """Whether Skill refuses skills without a free grasp, or tries them all the same."""
    scenes: int = 440
    """Plans that end-to-end learns from, one a scene."""
    resume: bool = False
    """Continue from the last checkpoint. All settings except --steps and --checkpoint-every must be the same."""
    json: Path | None = None
    """Write the histories of all runs to this file."""


def run(arguments: Arguments) -> None:
    """Train and print the histories."""
    if arguments.algorithm == "end-to-end":
        imitate_plans(arguments)
        return
    from clutter_env.errors import LearningError
    from clutter_env.reporting.files import write_json
    from clutter_env.training.run import runs_of_seeds
    from clutter_env.training.train import train_all

    if arguments.scenes != Arguments(arguments.algorithm).scenes:
        raise LearningError(f"--scenes is of end-to-end; {arguments.algorithm} takes --steps")
    runs = runs_of_seeds(make_run(arguments), arguments.seeds)
    trained = train_all(runs, arguments.workers, arguments.resume, arguments.ray, report=print_history)
    if arguments.json is not None:
        write_json(arguments.json, [{**one.describe(), **asdict(end)} for one, end in zip(runs, trained, strict=True)])


def imitate_plans(arguments: Arguments) -> None:
    """Train end to end from plans, and say how to play. Examples that are in the directory are not made again."""
    from clutter_env.errors import LearningError
    from clutter_env.training.end_to_end.train import train_end_to_end

    taken, plain = ("scenes", "seed", "out"), Arguments("end-to-end")
    others = [one.name for one in fields(Arguments) if getattr(arguments, one.name) != getattr(plain, one.name)]
    if refused := [name for name in others if name not in taken]:
        what = f"it takes --scenes, --seed and --out alone, not {', '.join(refused)}"
        raise LearningError(f"end-to-end learns from plans for Retrieve; {what}")
    directory = arguments.out or Path("outputs/runs") / f"end-to-end-{arguments.seed}"
    weights = train_end_to_end(directory, arguments.scenes, arguments.seed, print)
    print(f"play it: clutter-env evaluate --policy end-to-end:{weights}")


def print_history(run: Run, trained: Trained) -> None:
    """Print success at every checkpoint, and the times."""
    for entry in trained.history:
        print("  ".join(f"{name} {value:g}" for name, value in entry.items()))
    print(f"{run.directory}: {trained.wall_s:.0f} s, {trained.cpu_s:.0f} s of CPU time")


def make_run(arguments: Arguments) -> Run:
    """The run that the arguments describe. The environment refuses unknown arguments."""
    from clutter_env.errors import LearningError
    from clutter_env.task import Task
    from clutter_env.training.run import Run

    if arguments.geometric_mask and arguments.algorithm != "maskable-ppo":
        raise LearningError(f"--geometric-mask is about the masks of maskable-ppo; {arguments.algorithm} has none")
    algorithm = arguments.algorithm.replace("-", "_")
    keywords = {name: getattr(arguments, name) for name in _KEYWORDS if getattr(arguments, name)}
    task = Task(arguments.env or _ENVIRONMENTS[ALGORITHMS[algorithm][0]], keywords)
    if task.family == "skill":
        task = Task(task.env_id, {"simulation": "kinematic", **keywords})
    name = f"{algorithm}-{task.env_id.rpartition('/')[2].removesuffix('-v0').lower()}"
    if arguments.seeds == 1:
        name += f"-{arguments.seed}"
    return Run(task, algorithm, arguments.out or Path("outputs/runs") / name, arguments.seed, arguments.settings)
