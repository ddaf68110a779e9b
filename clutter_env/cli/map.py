"""Build the reachability map of a robot and save it.

The robot is one that the project knows by name, or your own `RobotSpec`, given as module:NAME. If it has an MJCF file,
its chain is first compared with the model: a map of wrong kinematics would be worse than none.
"""

from __future__ import annotations

import importlib
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import mujoco
import numpy as np

from assets.robots import RobotSpec, robot
from clutter_env.cli.command import run_command
from irm.arm.kinematics import ArmChain, forward
from irm.maps.grid import MapParameters
from irm.maps.reachability import ReachabilityMap

POSTURES = 200
TOLERANCE = 1e-6
"""[m] and of rotation matrices: kinematics agree to rounding or not at all."""


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    robot: str = "fetch"
    """Name of a robot, or module:NAME of a RobotSpec."""
    output: Path | None = None
    """Where the map goes; outputs/NAME.npz if not given."""
    voxel: float = 0.05
    """[m] edge of the position cells."""
    orientations: int = 62
    """Approach axes: 6, 26, 62, 114, 182, 266, ..."""
    rolls: int = 0
    """Roll samples for each axis; 0: 1 for a wrist that rolls freely, else 4."""
    pitches: tuple[float, ...] = ()
    """[degrees] rings of pitch to keep; all if not given."""
    heights: tuple[float, float] = (0.0, 10.0)
    """[m] lowest and highest hand position."""
    lift: bool = True
    """Whether the torso is free; if not it stays at its height at home."""
    samples: int = 400_000
    """Random configurations, for arms without a closed form."""
    seed: int = 0
    check: bool = True
    """Compare the chain with the robot's MJCF first."""
    json: Path | None = None
    """Where machine-readable results go."""


def run(arguments: Arguments) -> None:
    """Check, build, save, report."""
    specification = _robot(arguments.robot)
    if arguments.check:
        _check_against_model(specification)
    parameters = MapParameters(
        voxel=arguments.voxel,
        orientations=arguments.orientations,
        rolls=arguments.rolls,
        pitches=tuple(float(np.radians(pitch)) for pitch in arguments.pitches),
        heights=arguments.heights,
        lift=arguments.lift,
        samples=arguments.samples,
        seed=arguments.seed,
    )
    start = time.process_time()
    rm = ReachabilityMap.build(specification, progress=True, **asdict(parameters))
    seconds = time.process_time() - start
    output = arguments.output or Path("outputs") / f"{specification.name}.npz"
    rm.save(output)
    index = rm.reachability_index
    report = {
        "robot": rm.robot,
        "poses": len(rm),
        "voxels": int(np.count_nonzero(index)),
        "mean_reachability_index": float(index[index > 0].mean()) if len(rm) else 0.0,
        "best_manipulability": float(rm.manipulability.max(initial=0.0)),
        "build_s": seconds,
        "megabytes": output.stat().st_size / 1e6,
        "file": str(output),
    }
    for name, value in report.items():
        print(f"{name:>24}: {value:.4g}" if isinstance(value, float) else f"{name:>24}: {value}")
    if arguments.json is not None:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(report, indent=1))


def _robot(name: str) -> RobotSpec:
    """A known robot, or the `RobotSpec` that module:NAME says."""
    if ":" not in name:
        return robot(name)
    module, attribute = name.split(":", 1)
    found = getattr(importlib.import_module(module), attribute)
    if not isinstance(found, RobotSpec):
        raise SystemExit(f"{name} is a {type(found).__name__}, not a RobotSpec")
    return found


def _check_against_model(specification: RobotSpec) -> None:
    """Exit if the chain and the MJCF put the hand in different places."""
    model = mujoco.MjModel.from_xml_path(str(specification.mjcf_path))
    data, chain = mujoco.MjData(model), ArmChain.from_robot(specification)
    columns = [model.joint(link.joint).qposadr[0] for link in specification.chain]
    base, tcp = model.body(specification.base_body).id, model.site(specification.tcp_site).id
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(POSTURES):
        q = rng.uniform(np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi))
        data.qpos[columns] = q
        mujoco.mj_kinematics(model, data)
        R_base = data.xmat[base].reshape(3, 3)
        T = np.eye(4)
        T[:3, 3] = R_base.T @ (data.site_xpos[tcp] - data.xpos[base])
        T[:3, :3] = R_base.T @ data.site_xmat[tcp].reshape(3, 3)
        worst = max(worst, float(np.abs(T - forward(chain, q)).max()))
    if worst > TOLERANCE:
        raise SystemExit(f"the chain of {specification.name} does not agree with its MJCF: {worst:.3g} apart (m, or 1)")


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("map", Arguments, run, __doc__, words)
