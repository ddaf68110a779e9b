"""Random steps through every environment, watching for NaN, exceptions, numbers out of range and growing memory."""

from __future__ import annotations

import json
import resource
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

import clutter_env
from clutter_env.cli.command import run_command

IDS = (
    *(f"clutter_env/Retrieve-o{count}-v0" for count in clutter_env.OBJECT_COUNTS),
    "clutter_env/Reach-v0",
    "clutter_env/Pick-v0",
)
EPISODE_STEPS = 500
PAGE = resource.getpagesize()


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    steps: int = 1_000_000
    """Control steps in all, shared among the ids, control modes and layouts."""
    seed: int = 0
    json: Path | None = None
    """Where machine-readable results go."""


@dataclass
class Findings:
    """What was seen; `memory_mb` (n,) resident memory after each chunk."""

    steps: int
    episodes: int
    warnings: int
    memory_mb: list[float]


def soak(arguments: Arguments) -> Findings:
    """Run all chunks one after the other in this process.

    Raises:
        AssertionError: an observation is not in its space, or a reward is not finite.
    """
    chunks = [(env_id, mode, layout) for layout in ("paper", "shelf") for env_id in IDS for mode in ("joint", "ee")]
    share = -(-arguments.steps // len(chunks))
    findings = Findings(0, 0, 0, [])
    with tqdm(total=share * len(chunks), unit="step") as progress:
        for number, (env_id, mode, layout) in enumerate(chunks):
            env = gym.make(
                env_id, control_mode=mode, layout=layout, reward_mode="dense", max_episode_steps=EPISODE_STEPS
            )
            _run_chunk(env, share, arguments.seed + number, findings, progress)
            env.close()
            findings.memory_mb.append(_resident_mb())
    return findings


def _run_chunk(env: gym.Env, steps: int, seed: int, findings: Findings, progress: tqdm) -> None:
    """Actions that hold for a while and lean towards the table, so that the robot gets among the objects."""
    rng = np.random.default_rng(seed)
    ended = True
    size: int = env.unwrapped.action_size  # type: ignore[attr-defined]
    action: NDArray[np.float64] = np.zeros(size)
    for step in range(steps):
        if ended:
            env.reset(seed=int(rng.integers(2**31)))
            findings.episodes += 1
        if step % 5 == 0 or ended:
            action = rng.uniform(-1, 1, size)
            action[0] = rng.uniform(-0.3, 0.7)
        observation, reward, terminated, truncated, _ = env.step(action)
        ended = terminated or truncated
        assert observation in env.observation_space, f"{env.spec}: observation out of range at step {step}"
        assert np.isfinite(float(reward)), f"{env.spec}: reward {reward} at step {step}"
        findings.steps += 1
        if step % 1000 == 0:
            progress.update(min(1000, steps - step))
    findings.warnings += int(sum(warning.number for warning in env.unwrapped.data.warning))  # type: ignore[attr-defined]


def _resident_mb() -> float:
    """Resident memory of this process now; its peak where the system does not tell."""
    status = Path("/proc/self/statm")
    if status.is_file():
        return int(status.read_text().split()[1]) * PAGE / 2**20
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def run(arguments: Arguments) -> None:
    """Soak, then print what was seen."""
    start = time.process_time()
    findings = soak(arguments)
    half = len(findings.memory_mb) // 2
    print(f"{findings.steps} steps, {findings.episodes} episodes, {time.process_time() - start:.0f} s of CPU time")
    print(f"warnings from MuJoCo: {findings.warnings}")
    print(
        f"resident memory: {findings.memory_mb[half]:.0f} MB at half time, {findings.memory_mb[-1]:.0f} MB at the end"
    )
    if arguments.json is not None:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(vars(findings), indent=1))


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("soak", Arguments, run, __doc__, words)
