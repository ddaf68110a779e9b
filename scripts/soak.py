"""Random steps through every environment: no warning, no exception, no number out of range, no growing memory.

python scripts/soak.py --steps 2000000
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import tyro
from numpy.typing import NDArray

import clutter_env
from clutter_env.config import CONTROL_MODES, EnvConfig
from clutter_env.envs.base import BaseEnv
from clutter_env.errors import ConfigError
from clutter_env.reporting.files import write_json
from clutter_env.reporting.progress import progress_bar
from clutter_env.scene.layout import LAYOUTS

IDS = (
    *(f"clutter_env/Retrieve-o{count}-v0" for count in clutter_env.OBJECT_COUNTS),
    "clutter_env/Reach-v0",
    "clutter_env/Pick-v0",
)
VARIANTS: tuple[dict[str, Any], ...] = (
    {},
    {"object_set": "lying", "shapes": "mixed"},
    {"obstructed": True},
    {"object_set": "low", "shapes": "box", "success": "lifted"},
    {"object_set": "tall", "terminate_on_fallen": True},
    {"object_set": "heavy", "shapes": "mixed"},
    {"obstructed": 2, "success": "lifted"},
)
"""Further keyword arguments, which the environments of Retrieve take in turn, as far as their objects fit."""
OBSTRUCTED_OBJECTS = 20
"""Objects from which obstructed targets are common on every layout."""
EPISODE_STEPS = 500
ACTION_STEPS = 5
"""Steps for which a random action is kept, so that the robot gets somewhere."""
FORWARD_RANGE = (-0.3, 0.7)
"""Random base velocity forward: towards the table on average, so that the robot reaches the objects."""
REPORT_STEPS = 1000
PAGE = resource.getpagesize()


class EnduranceError(ValueError):
    """An environment broke its promises: an observation outside its space, or a reward that is not finite."""


@dataclass
class EnduranceResult:
    """Counts of a run, MuJoCo's warnings (kind, environment, seed, step), resident memory [MB] by environment."""

    steps: int = 0
    episodes: int = 0
    warnings: list[str] = field(default_factory=list)
    memory_mb: list[float] = field(default_factory=list)

    def summary(self) -> str:
        """The counts in words."""
        half = len(self.memory_mb) // 2
        first, second = self.memory_mb[: half + 1], self.memory_mb[half:]
        lines = "".join(f"  {line}\n" for line in self.warnings)
        return (
            f"{self.steps} steps, {self.episodes} episodes\n"
            f"warnings from MuJoCo: {len(self.warnings)}\n{lines}"
            f"resident memory: at most {max(first):.0f} MB in the first half, {max(second):.0f} MB in the second"
        )


def main(steps: int = 1_000_000, seed: int = 0, json: Path | None = None) -> None:
    """Step, then print the counts.

    Args:
        steps: Control steps in all, shared among the ids, control modes and layouts.
        seed: Random seed of scenes and actions.
        json: File of machine-readable results.
    """
    start = time.process_time()
    with progress_bar(total=steps, desc="stepping", unit="step") as bar:
        result = run_endurance(steps, seed, bar.update)
    print(f"{result.summary()}\nCPU time: {time.process_time() - start:.0f} s")
    if json is not None:
        write_json(json, result)


def run_endurance(steps: int, seed: int, report: Callable[[int], None] = lambda _: None) -> EnduranceResult:
    """Step all ids in both control modes and all layouts, one after the other in this process.

    Args:
        steps: control steps in all, shared equally; rounded up to a whole number for each environment.
        seed: of scenes and actions.
        report: called with the number of steps done since the last call.

    Raises:
        EnduranceError: an observation is not in its space, or a reward is not finite.
        ValueError: no steps.
    """
    if steps < 1:
        raise ValueError(f"steps={steps} must be at least 1")
    kinds = _kinds()
    share = -(-steps // len(kinds))
    result = EnduranceResult()
    for number, (env_id, keywords) in enumerate(kinds):
        env = gym.make(env_id, reward_mode="dense", max_episode_steps=EPISODE_STEPS, **keywords)
        _run_one(env, share, seed + number, result, report)
        env.close()
        result.memory_mb.append(int(Path("/proc/self/statm").read_text().split()[1]) * PAGE / 2**20)
    return result


def _kinds() -> list[tuple[str, dict[str, Any]]]:
    """Id and keyword arguments of every environment; those with more objects than fit their table are left out."""
    kinds, waiting = [], list(VARIANTS)
    for layout, env_id, mode in product(LAYOUTS, IDS, CONTROL_MODES):
        keywords = {"control_mode": mode, "layout": layout, **gym.spec(env_id).kwargs}
        if "Retrieve" not in env_id:
            kinds.append((env_id, keywords))
            continue
        variant = next((variant for variant in waiting if _can_be_drawn(keywords | variant)), None)
        if variant is not None:
            kinds.append((env_id, keywords | variant))
            waiting.remove(variant)
            waiting.append(variant)
    return kinds


def _can_be_drawn(keywords: dict[str, Any]) -> bool:
    """Whether the objects fit the table, and obstructed targets are common among them."""
    try:
        config = EnvConfig.from_keywords(keywords)
    except ConfigError:
        return False
    return not config.obstructed or config.num_objects >= OBSTRUCTED_OBJECTS


def _run_one(env: gym.Env, steps: int, seed: int, result: EnduranceResult, report: Callable[[int], None]) -> None:
    base = env.unwrapped
    assert isinstance(base, BaseEnv)
    rng = np.random.default_rng(seed)
    has_ended, episode_seed, first_step = True, seed, 0
    action: NDArray[np.float64] = np.zeros(base.action_size)
    for step in range(steps):
        if has_ended:
            episode_seed, first_step = int(rng.integers(2**31)), step
            env.reset(seed=episode_seed)
            result.episodes += 1
        if step % ACTION_STEPS == 0 or has_ended:
            action = rng.uniform(-1, 1, base.action_size)
            action[0] = rng.uniform(*FORWARD_RANGE)
        observation, reward, terminated, truncated, _ = env.step(action)
        # Every reset clears the counters, so that these are warnings of this episode.
        kinds = np.flatnonzero(base.data.warning.number).tolist()
        warned = [mujoco.mjtWarning(kind).name.removeprefix("mjWARN_") for kind in kinds]
        result.warnings += [f"{name}: {env.spec}, seed {episode_seed}, step {step - first_step}" for name in warned]
        has_ended = terminated or truncated or bool(warned)
        if observation not in env.observation_space:
            raise EnduranceError(f"{env.spec}: observation outside its space at step {step}, seed {seed}")
        if not np.isfinite(float(reward)):
            raise EnduranceError(f"{env.spec}: reward {reward} at step {step}, seed {seed}")
        if step % REPORT_STEPS == 0:
            report(min(REPORT_STEPS, steps - step))
    result.steps += steps


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
