"""Train a policy, from rewards or from demonstrations, with checkpoints and TensorBoard logs.

    clutter-env train tqc --env clutter_env/ArmReach-v0 --steps 20000
    clutter-env train maskable-ppo --env clutter_env/Skill-o10-v0 --steps 30000 --seeds 3 --workers 2
    clutter-env train bc --env clutter_env/Pick-v0 --demos outputs/demos/pick
    clutter-env train keyframes --demos outputs/demos/o15
    clutter-env train keyframes --env clutter_env/Retrieve-o25-v0 --grasps all --steps 6000
    clutter-env train decisions --env clutter_env/Retrieve-o15-v0 --obstructed --rounds 2 --round-episodes 60

`clutter-env train ALGORITHM --help` lists the options of an algorithm. Without --out a run is written to a directory of
its own under outputs/runs.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from clutter_env.training.settings import (
    BC,
    DQN,
    PPO,
    SAC,
    TQC,
    Decisions,
    Keyframes,
    MaskablePPO,
    Settings,
)

if TYPE_CHECKING:
    from clutter_env.training.run import Run
    from clutter_env.training.train import Trained

_ENVIRONMENTS = {
    "reach": "clutter_env/ArmReach-v0",
    "skill": "clutter_env/Skill-o15-v0",
    "retrieve": "clutter_env/Retrieve-o15-v0",
}
"""Environments to learn on if none is given, by the family that an algorithm is for."""
WHEN_INTERRUPTED = "run the same command again with --resume to go on from the last checkpoint"


@tyro.conf.configure(tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes, tyro.conf.CascadeSubcommandArgs)
@dataclass(frozen=True)
class Arguments:
    """Train a policy."""

    settings: (
        Annotated[SAC, tyro.conf.subcommand("sac")]
        | Annotated[TQC, tyro.conf.subcommand("tqc")]
        | Annotated[PPO, tyro.conf.subcommand("ppo")]
        | Annotated[MaskablePPO, tyro.conf.subcommand("maskable-ppo")]
        | Annotated[DQN, tyro.conf.subcommand("dqn")]
        | Annotated[BC, tyro.conf.subcommand("bc")]
        | Annotated[Keyframes, tyro.conf.subcommand("keyframes")]
        | Annotated[Decisions, tyro.conf.subcommand("decisions")]
    )
    """Algorithm, and its options."""
    env: str = ""
    """Environment id. Without it, that of the demonstrations with all of its keyword arguments; or, for algorithms that
    learn without demonstrations, clutter_env/ArmReach-v0, Skill-o15-v0 or Retrieve-o15-v0."""
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
    control_mode: Literal["joint", "ee", ""] = ""
    """Control mode of the environment; empty for its own, as below."""
    reward_mode: Literal["sparse", "dense", ""] = ""
    """Reward mode."""
    layout: str = ""
    """Table and surroundings."""
    obstructed: bool = False
    """Only scenes whose target no side grasp reaches without moving something."""
    simulation: Literal["physics", "kinematic", ""] = ""
    """Simulation of Skill; empty for the kinematic model."""
    geometric_mask: bool = False
    """Leave out skills without a free grasp while learning Skill."""
    feasibility: Literal["oracle", "none", ""] = ""
    """Whether Skill refuses skills without a free grasp, or tries them all the same."""
    resume: bool = False
    """Go on from the last checkpoint; all settings but --steps and --checkpoint-every must be the same."""
    json: Path | None = None
    """Write the histories of all runs to this file."""


def run(arguments: Arguments) -> None:
    """Train and print the histories."""
    from clutter_env.reporting.files import write_json
    from clutter_env.training.run import runs_of_seeds
    from clutter_env.training.train import train_all

    runs = runs_of_seeds(make_run(arguments), arguments.seeds)
    trained = train_all(runs, arguments.workers, arguments.resume, arguments.ray, report=print_history)
    if arguments.json is not None:
        write_json(arguments.json, [{**one.describe(), **asdict(end)} for one, end in zip(runs, trained, strict=True)])


def print_history(run: Run, trained: Trained) -> None:
    """Print success at every checkpoint, and the times."""
    for entry in trained.history:
        print("  ".join(f"{name} {value:g}" for name, value in entry.items()))
    if not trained.history:
        print("success was not measured: that is done every --checkpoint-every steps")
    print(f"{run.directory}: {trained.wall_s:.0f} s, {trained.cpu_s:.0f} s of CPU time")


def make_run(arguments: Arguments) -> Run:
    """The run that the arguments describe; the environment refuses what it does not know."""
    from clutter_env.data.dataset import Dataset
    from clutter_env.task import Task
    from clutter_env.training.run import Run

    settings: Settings = arguments.settings
    names = ("control_mode", "reward_mode", "layout", "obstructed", "simulation", "geometric_mask", "feasibility")
    keywords = {name: getattr(arguments, name) for name in names if getattr(arguments, name)}
    if arguments.env:
        task = Task(arguments.env, keywords)
    elif demos := getattr(settings, "demos", None):
        collected = Dataset(demos).task
        task = Task(collected.env_id, {**collected.keywords, **keywords})
    else:
        task = Task(_ENVIRONMENTS[settings.families[0]], keywords)
    if task.family == "skill":
        task = Task(task.env_id, {"simulation": "kinematic", **task.keywords})
    name = f"{settings.algorithm}-{task.env_id.rpartition('/')[2].removesuffix('-v0').lower()}"
    if arguments.seeds == 1:
        name += f"-{arguments.seed}"
    directory = arguments.out or Path("outputs/runs") / name
    return Run(task, settings, directory, arguments.seed)
