"""Train a policy, from rewards or from demonstrations; checkpoints, TensorBoard logs and resuming included.

python scripts/train.py --env clutter_env/Reach-v0 --algorithm sac --steps 30000
python scripts/train.py --env clutter_env/Skill-o10-v0 --algorithm maskable_ppo --steps 30000
python scripts/train.py --env clutter_env/Pick-v0 --algorithm bc --steps 10000 --demos outputs/demos/pick
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from clutter_env.cli.command import run_command
from clutter_env.learning.task import Task
from clutter_env.learning.training.training import Run, train
from clutter_env.reporting.json_file import write_json


@dataclass(frozen=True)
class Arguments:
    """Train a policy."""

    env: str = "clutter_env/Reach-v0"
    """Environment id."""
    algorithm: Literal["sac", "tqc", "ppo", "maskable_ppo", "bc", "dagger"] = "sac"
    """SAC and TQC (with hindsight) for Reach and Pick, PPO and MaskablePPO for Skill, BC and DAgger for all others."""
    steps: int = 30_000
    """Steps of the environment; gradient steps of bc, and of each round of dagger."""
    seed: int = 0
    """Of everything random."""
    out: Path | None = None
    """Directory of the run; without it, outputs/runs/ALGORITHM-ENV-SEED."""
    demos: Path | None = None
    """Dataset of collect_demos.py: cloned by bc and dagger, put in the replay buffer of sac and tqc."""
    demo_episodes: int | None = None
    """How many of its episodes to use; all by default."""
    imitation_steps: int = 10_000
    """Gradient steps for which the actor of sac and tqc first imitates the demonstrations."""
    control_mode: Literal["joint", "ee", ""] = ""
    """Control mode; empty for the environment's own."""
    reward_mode: Literal["sparse", "dense", ""] = ""
    """Reward mode; empty for the environment's own."""
    simulation: Literal["physics", "kinematic"] = "kinematic"
    """Where Skill is learnt."""
    geometric_mask: bool = False
    """Leave out skills without a free grasp while learning Skill."""
    rounds: int = 5
    """Rounds of dagger."""
    round_episodes: int = 10
    """The learner's episodes in each."""
    expert: str = ""
    """Who corrects in dagger; empty for the one that the demonstrations are of."""
    checkpoint_every: int = 5000
    """Steps between checkpoints."""
    evaluation_episodes: int = 20
    """Held-out scenes played at every checkpoint."""
    evaluation_steps: int = 600
    """Where each of them is cut off."""
    resume: bool = False
    """Go on from the last checkpoint."""
    json: Path | None = None
    """Write the history to this file."""


def run(arguments: Arguments) -> None:
    """Train and say how it went."""
    run = make_run(arguments)
    started, started_cpu = time.perf_counter(), time.process_time()
    history = train(run, arguments.resume)
    wall_s, cpu_s = time.perf_counter() - started, time.process_time() - started_cpu
    for entry in history:
        print("  ".join(f"{name} {value:g}" for name, value in entry.items()))
    print(f"{run.directory}: {wall_s:.0f} s, {cpu_s:.0f} s of CPU time")
    if arguments.json is not None:
        write_json(arguments.json, {**run.describe(), "history": history, "wall_s": wall_s, "cpu_s": cpu_s})


def make_run(arguments: Arguments) -> Run:
    """The run that the arguments describe."""
    keywords: dict[str, Any] = {}
    if arguments.control_mode:
        keywords["control_mode"] = arguments.control_mode
    if arguments.reward_mode:
        keywords["reward_mode"] = arguments.reward_mode
    if "/Skill" in arguments.env:
        keywords |= {"simulation": arguments.simulation, "geometric_mask": arguments.geometric_mask}
    name = arguments.env.rpartition("/")[2].removesuffix("-v0").lower()
    return Run(
        task=Task(arguments.env, keywords),
        algorithm=arguments.algorithm,
        steps=arguments.steps,
        directory=arguments.out or Path(f"outputs/runs/{arguments.algorithm}-{name}-{arguments.seed}"),
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
    )


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("train", Arguments, run, __doc__, words)
