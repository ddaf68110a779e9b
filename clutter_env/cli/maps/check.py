"""Measure the answers about any arm in an MJCF file: the map alone, and `decide`, against MuJoCo.

    clutter-env map check panda.xml --base link0 --tip hand --approach z

Random poses in the ball of the stretched arm, above the floor. A wrong answer is a NO for a pose that some
configuration reaches in MuJoCo, or a YES without such a configuration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from clutter_env.reporting.command import run_command


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    mjcf: tyro.conf.Positional[Path]
    """MJCF file of an arm."""
    base: str
    """Body whose frame is the base frame, with z up."""
    tip: str
    """Site or body whose frame is the TCP frame."""
    approach: Literal["x", "-x", "y", "-y", "z", "-z"] = "x"
    """Axis of the tip along which the gripper approaches."""
    voxel: float = 0.05
    """Edge of the position cells of the map [m]."""
    orientations: int = 62
    """Number of approach axes of the map."""
    poses: int = 100_000
    """Random poses, and as many poses of random configurations."""
    refutations: int = 300
    """Poses answered with NO for which inverse kinematics by MuJoCo tries to find a solution."""
    seed: int = 0
    """Random seed."""
    json: Path | None = None
    """File for machine-readable results."""


def run(arguments: Arguments) -> None:
    """Build the map, measure, and print one line for each number."""
    from clutter_env.experiments.maps.arm_answers import measure_arm
    from clutter_env.experiments.maps.model_check import checked_arm
    from clutter_env.reporting.files import write_json
    from irm.maps.grid import MapParameters

    arm = checked_arm(arguments.mjcf, arguments.base, arguments.tip, arguments.approach)
    parameters = MapParameters(voxel=arguments.voxel, orientations=arguments.orientations)
    answers = measure_arm(arm, parameters, (arguments.poses, arguments.refutations), arguments.seed)
    for name, value in vars(answers).items():
        print(f"{name:>26}: {f'{value:.4g}' if isinstance(value, float) else value}")
    if arguments.json is not None:
        write_json(arguments.json, answers)


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("map check", Arguments, run, __doc__, words)
