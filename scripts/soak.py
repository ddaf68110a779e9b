"""Steps through every environment, random ones and blind grasps: no warning, no exception, no number out of range, no
growing memory.

python scripts/soak.py --steps 2000000
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import tyro
from numpy.typing import NDArray

import clutter_env  # noqa: F401  registers the environments
from clutter_env.config import CONTROL_MODES, EnvConfig
from clutter_env.envs.base import BaseEnv
from clutter_env.envs.rearrange import RearrangeConfig
from clutter_env.envs.rearrange_tasks import TASKS
from clutter_env.envs.search import SearchConfig
from clutter_env.envs.skill import SkillEnv
from clutter_env.errors import ConfigError
from clutter_env.reporting.files import write_json
from clutter_env.reporting.progress import progress_bar
from clutter_env.scene.layout import LAYOUTS, OPENS

ALL_IDS = tuple(name for name in gym.registry if name.startswith("clutter_env/"))
SKILL_IDS = tuple(name for name in ALL_IDS if "/Skill-" in name)
ARM_IDS = tuple(name for name in ALL_IDS if "/Arm" in name)
"""They have one robot and one control mode."""
TASK_IDS = tuple(name for name in ALL_IDS if "/Rearrange-" in name)
"""Their tasks have layouts of their own."""
SEARCH_IDS = tuple(name for name in ALL_IDS if "/Search-" in name)
"""The first of them stands for all: the physics is that of Retrieve, and images take long."""
_SEARCH = {"image_size": 16, "frame_every": 10, "mask_errors": 0.05, "depth_noise": 0.005}
IDS = tuple(name for name in ALL_IDS if name not in (*SKILL_IDS, *ARM_IDS, *TASK_IDS, *SEARCH_IDS))
ROBOTS = ("fetch", "pr2", "panda_mobile")
"""The robots, which the environments have in turn."""
VARIANTS: tuple[dict[str, Any], ...] = (
    {},
    {"object_set": "lying", "shapes": "mixed"},
    {"obstructed": True},
    {"object_set": "low", "shapes": "box", "success": "lifted"},
    {"object_set": "tall", "terminate_on_fallen": True},
    {"object_set": "heavy", "shapes": "mixed"},
    {"obstructed": 2, "success": "lifted"},
    {"object_set": "household"},
    {"reality": 0.5},
    {"reality": 1.0, "object_set": "household"},
)
"""Further keyword arguments, which the environments of Retrieve take in turn, as far as their objects fit."""
_VARIANTS_OF_THE_WORLD = VARIANTS[-3:]
OBSTRUCTED_OBJECTS = 20
"""Objects from which obstructed targets are common on every layout."""
EPISODE_STEPS = 500
ACTION_STEPS = 5
"""Steps for which a random action is kept, so that the robot gets somewhere."""
FORWARD_RANGE = (-0.3, 0.7)
"""Random base velocity forward: towards the table on average, so that the robot reaches the objects."""
STAND_OFF = 0.85
"""[m] from the base to an object that the gripper grasps."""
_GRASP = (
    (-1.2, -0.4, 0.1, True, 60),
    (-STAND_OFF, -0.14, 0.0, True, 50),
    (-STAND_OFF, 0.0, 0.0, True, 40),
    (-STAND_OFF, 0.0, 0.0, False, 15),
    (-STAND_OFF, 0.0, 0.15, False, 30),
    (-1.6, -0.75, 0.15, False, 60),
    (-1.6, -0.75, 0.15, True, 20),
)
"""Goals of a blind grasp: x [m] of the base, x and z [m] of the TCP, all from the object's centre; whether the gripper
is to be open; for how many steps."""
REPORT_STEPS = 1000
PAGE = resource.getpagesize()


class EnduranceError(ValueError):
    """An environment broke its promises: an observation outside its space, or a reward that is not finite."""


@dataclass
class EnduranceResult:
    """Counts of a run, MuJoCo's warnings (kind, environment, seed, step), resident memory [MB] after each round."""

    steps: int = 0
    episodes: int = 0
    warnings: list[str] = field(default_factory=list)
    memory_mb: list[float] = field(default_factory=list)

    def summary(self) -> str:
        """The counts in words."""
        lines = "".join(f"  {line}\n" for line in self.warnings)
        memory = ", ".join(f"{value:.0f}" for value in self.memory_mb)
        return (
            f"{self.steps} steps, {self.episodes} episodes\n"
            f"warnings from MuJoCo: {len(self.warnings)}\n{lines}"
            f"resident memory after each round: {memory} MB"
        )


def main(steps: int = 1_000_000, seed: int = 0, json: Path | None = None, household: bool = False) -> None:
    """Step, then print the counts.

    Args:
        steps: Control steps in all, shared among the ids, control modes and layouts.
        seed: Random seed of scenes and actions.
        json: File of machine-readable results.
        household: Retrieve with household objects or `reality` alone.
    """
    start = time.process_time()
    with progress_bar(total=steps, desc="stepping", unit="step") as bar:
        result = run_endurance(steps, seed, bar.update, _VARIANTS_OF_THE_WORLD if household else None)
    print(f"{result.summary()}\nCPU time: {time.process_time() - start:.0f} s")
    if json is not None:
        write_json(json, result)


def run_endurance(
    steps: int,
    seed: int,
    report: Callable[[int], None] = lambda _: None,
    variants: tuple[dict[str, Any], ...] | None = None,
) -> EnduranceResult:
    """Step all ids in both control modes and all layouts, in rounds of about one episode each, in this process.

    Every round has other scenes and actions; every second one makes blind grasps in place of random actions.

    Args:
        steps: control steps in all, shared equally; rounded up to a whole number for each environment. The motions of
            skills come on top.
        seed: of scenes and actions.
        report: called with the number of steps done since the last call.
        variants: keyword arguments that environments of Retrieve take in turn, then the only ones; all ids without.

    Raises:
        EnduranceError: an observation is not in its space, or a reward is not finite.
        ValueError: no steps.
    """
    if steps < 1:
        raise ValueError(f"steps={steps} must be at least 1")
    kinds = _kinds(VARIANTS) if variants is None else [kind for kind in _kinds(variants) if "Retrieve" in kind[0]]
    rounds = max(round(steps / (EPISODE_STEPS * len(kinds))), 1)
    share = -(-steps // (rounds * len(kinds)))
    result = EnduranceResult()
    for turn in range(rounds):
        for number, (env_id, keywords) in enumerate(kinds):
            robots = ROBOTS[:1] if env_id in ARM_IDS else _from(ROBOTS, turn + number)
            robot = next(robot for robot in robots if _can_be_drawn(keywords | {"robot": robot}))
            rewarded = "staged" if "ArmRetrieve" in env_id else "dense"
            env = gym.make(env_id, reward_mode=rewarded, max_episode_steps=EPISODE_STEPS, **keywords, robot=robot)
            is_grasping = bool(turn % 2) and env_id not in ARM_IDS
            _run_one(env, share, seed + turn * len(kinds) + number, is_grasping, result, report)
            env.close()
        if share == EPISODE_STEPS and variants is None:
            for number, env_id in enumerate(SKILL_IDS):
                _run_skills(gym.make(env_id, robot=ROBOTS[0]), seed + turn * len(SKILL_IDS) + number, result)
        result.memory_mb.append(int(Path("/proc/self/statm").read_text().split()[1]) * PAGE / 2**20)
        print(f"round {turn + 1} of {rounds}: {result.summary()}", flush=True)
    return result


@cache
def _what_opens(env_id: str) -> tuple[str | None, ...]:
    """What may open in the layouts of an environment; in those of Skill, as in those of Retrieve, anything."""
    with closing(gym.make(env_id)) as env:
        return tuple(getattr(env.unwrapped, "opens", OPENS))


def _kinds(variants: tuple[dict[str, Any], ...]) -> list[tuple[str, dict[str, Any]]]:
    """Id and keyword arguments of every environment; those with more objects than fit their table are left out."""
    kinds: list[tuple[str, dict[str, Any]]] = [(env_id, {}) for env_id in ARM_IDS]
    for env_id, mode, task in product(TASK_IDS, CONTROL_MODES, TASKS):
        kinds.append((env_id, {"control_mode": mode, "task": task, **gym.spec(env_id).kwargs}))
    waiting = list(variants)
    for layout, env_id, mode in product(LAYOUTS, IDS, CONTROL_MODES):
        if LAYOUTS[layout].opens not in _what_opens(env_id):
            continue
        keywords = {"control_mode": mode, "layout": layout, **gym.spec(env_id).kwargs}
        if "Retrieve" not in env_id:
            kinds.append((env_id, keywords))
            continue
        variant = next((variant for variant in waiting if _can_be_drawn(keywords | variant)), None)
        if variant is not None:
            kinds.append((env_id, keywords | variant))
            waiting.remove(variant)
            waiting.append(variant)
    for mode in CONTROL_MODES:
        kinds.append((SEARCH_IDS[0], {"control_mode": mode, **_SEARCH, **gym.spec(SEARCH_IDS[0]).kwargs}))
    return kinds


def _can_be_drawn(keywords: dict[str, Any]) -> bool:
    """Whether the objects fit the table, and obstructed targets are common among them."""
    try:
        kind = RearrangeConfig if "task" in keywords else SearchConfig if "frame_every" in keywords else EnvConfig
        config = kind.from_keywords(keywords)
    except ConfigError:
        return False
    return not config.obstructed or config.num_objects >= OBSTRUCTED_OBJECTS


def _from(values: tuple[str, ...], first: int) -> tuple[str, ...]:
    """The values in turn, the one of this number first."""
    return tuple(values[(first + index) % len(values)] for index in range(len(values)))


def _run_one(
    env: gym.Env, steps: int, seed: int, is_grasping: bool, result: EnduranceResult, report: Callable[[int], None]
) -> None:
    base = env.unwrapped
    assert isinstance(base, BaseEnv)
    rng = np.random.default_rng(seed)
    motions = blind_grasps if is_grasping and base.world.shapes else _random_actions
    has_ended, episode_seed, first_step = True, seed, 0
    actions: Iterator[NDArray[np.float64]] = iter(())
    for step in range(steps):
        if has_ended:
            episode_seed, first_step = int(rng.integers(2**31)), step
            env.reset(seed=episode_seed)
            actions = motions(base, rng)
            result.episodes += 1
        observation, reward, terminated, truncated, _ = env.step(next(actions))
        warned = _warnings(base)
        result.warnings += [f"{name}: {env.spec}, seed {episode_seed}, step {step - first_step}" for name in warned]
        has_ended = terminated or truncated or bool(warned)
        if observation not in env.observation_space:
            raise EnduranceError(f"{env.spec}: observation outside its space at step {step}, seed {seed}")
        if not np.isfinite(float(reward)):
            raise EnduranceError(f"{env.spec}: reward {reward} at step {step}, seed {seed}")
        if step % REPORT_STEPS == 0:
            report(min(REPORT_STEPS, steps - step))
    result.steps += steps


def _run_skills(env: gym.Env, seed: int, result: EnduranceResult) -> None:
    """One episode of random skills."""
    skills = env.unwrapped
    assert isinstance(skills, SkillEnv)
    rng, has_ended = np.random.default_rng(seed), False
    env.reset(seed=seed)
    result.episodes += 1
    while not has_ended:
        observation, _, terminated, truncated, _ = env.step(rng.choice(np.flatnonzero(skills.action_masks())))
        result.warnings += [f"{name}: {env.spec}, seed {seed}" for name in _warnings(skills.physics_env)]
        has_ended = terminated or truncated
        if observation not in env.observation_space:
            raise EnduranceError(f"{env.spec}: observation outside its space, seed {seed}")
    result.steps += len(skills.physics_env.actions)


def _warnings(base: BaseEnv) -> list[str]:
    """Kinds of MuJoCo's warnings in this episode: every reset clears the counters."""
    return [mujoco.mjtWarning(kind).name.removeprefix("mjWARN_") for kind in np.flatnonzero(base.data.warning.number)]


def _random_actions(base: BaseEnv, rng: np.random.Generator) -> Iterator[NDArray[np.float64]]:
    while True:
        action = rng.uniform(-1, 1, base.action_size)
        action[0] = rng.uniform(*FORWARD_RANGE)
        yield from [action] * ACTION_STEPS


def blind_grasps(base: BaseEnv, rng: np.random.Generator) -> Iterator[NDArray[np.float64]]:
    """Grasp random objects from the front, whatever is in the way: approach, close, lift, drive back, open."""
    follower = base.tcp_follower()
    follower.reset(base.world.controller.state.target[3:])
    while True:
        x, y, z = base.measurements.poses[rng.integers(len(base.measurements.poses)), :3]
        for base_x, tcp_x, tcp_z, is_open, steps in _GRASP:
            pose, width = np.eye(4), base.robot.max_opening * is_open
            for _ in range(steps):
                stand = np.array([x + base_x, y, 0.0])
                if base.control_mode == "ee":
                    pose[:3, 3] = x + tcp_x, y, z + tcp_z
                    yield base.ee_action(stand, pose, width)
                else:
                    pose[:3, 3] = tcp_x - base_x, 0.0, z + tcp_z
                    yield base.joint_action(np.concatenate((stand, follower.step(pose))), width)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
