"""Train stock learners of Stable-Baselines3 and sb3-contrib: no subclass, no wrapper, only settings.

    python scripts/stock_learning.py --env ArmReach-v0 --algo tqc --steps 20000
    python scripts/stock_learning.py --env ArmPick-v0 --algo tqc --steps 500000 --num-envs 8 --device cuda

Writes `ENV-ALGO-SEED.json`, the learning curve: after every evaluation the success on held-out scenes, with the
settings, steps, gradient updates, and wall and CPU time; and beside it the last actor or policy, `.npz`.

The goal environments use the settings of RL Baselines3 Zoo for FetchReach-v1 and FetchPickAndPlace-v1, without its
normalisation; Retrieve the defaults of Stable-Baselines3 and the discount of its dense reward; Skill a larger batch.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import gymnasium as gym
import numpy as np
import torch
import tyro
from sb3_contrib import TQC, MaskablePPO
from sb3_contrib.common.maskable.utils import get_action_masks
from stable_baselines3 import DQN, PPO, SAC, HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from clutter_env.seeds import HELD_OUT, training_seeds
from clutter_env.task import family

LEARNERS: Mapping[str, type[BaseAlgorithm]] = {
    "sac": SAC,
    "tqc": TQC,
    "ppo": PPO,
    "dqn": DQN,
    "maskable_ppo": MaskablePPO,
}
_HINDSIGHT = {
    "replay_buffer_class": HerReplayBuffer,
    "replay_buffer_kwargs": {"n_sampled_goal": 4, "goal_selection_strategy": "future"},
    "learning_rate": 1e-3,
    "gamma": 0.95,
}
_REACH = {**_HINDSIGHT, "batch_size": 256, "learning_starts": 1000, "policy_kwargs": {"net_arch": [64, 64]}}
_PICK = {
    **_HINDSIGHT,
    "batch_size": 2048,
    "tau": 0.05,
    "learning_starts": 1000,
    "policy_kwargs": {"net_arch": [512, 512, 512], "n_critics": 2},
}
SETTINGS: Mapping[tuple[str, str], Mapping[str, Any]] = {
    ("armreach", "sac"): _REACH,
    ("armreach", "tqc"): _REACH,
    ("armpick", "sac"): _PICK,
    ("armpick", "tqc"): _PICK,
    ("retrieve", "sac"): {"gamma": 0.99, "learning_starts": 10_000},
    ("retrieve", "tqc"): {"gamma": 0.99, "learning_starts": 10_000},
    ("retrieve", "ppo"): {"gamma": 0.99, "n_steps": 512, "batch_size": 256},
    ("skill", "maskable_ppo"): {"gamma": 0.97, "n_steps": 512, "batch_size": 256},
    ("skill", "dqn"): {"gamma": 0.97, "learning_starts": 1000, "exploration_fraction": 0.3},
}
"""Arguments of a learner beyond the defaults of Stable-Baselines3, by family of environments and name."""
_KEYWORDS: Mapping[str, Mapping[str, Any]] = {
    "retrieve": {"control_mode": "ee", "reward_mode": "dense"},
    "skill": {"simulation": "kinematic", "obstructed": True},
}
_AT_ONCE = 10
"""Held-out episodes that are played side by side."""


@dataclass(frozen=True)
class Arguments:
    """What to train."""

    env: str = "ArmReach-v0"
    """Environment of the package."""
    algo: Literal["sac", "tqc", "ppo", "dqn", "maskable_ppo"] = "tqc"
    """Learner."""
    seed: int = 0
    """Random seed."""
    steps: int = 20_000
    """Steps of the environment, those of all copies counted."""
    num_envs: int = 1
    """Copies of the environment."""
    processes: bool = False
    """Whether each copy has its own process."""
    gradient_steps: int = 1
    """Gradient steps after each step of all copies; off-policy learners only."""
    batch_size: int = 0
    """Transitions in a batch; 0 for that of the settings."""
    net: tuple[int, ...] = ()
    """Units of the hidden layers; those of the settings by default."""
    every: int = 2000
    """Steps between evaluations."""
    episodes: int = 100
    """Held-out episodes of an evaluation."""
    device: str = "cpu"
    """Device of the networks."""
    minutes: float = 0.0
    """Wall time after which training ends early; 0 for none."""
    out: Path = Path("outputs/stock")
    """Directory of the results."""


def main(arguments: Arguments) -> None:
    """Train, evaluate and write the curve."""
    training_seeds(arguments.seed, arguments.num_envs)
    torch.set_num_threads(1)
    env_id = f"clutter_env/{arguments.env}"
    kind = family(env_id)
    if (kind, arguments.algo) not in SETTINGS:
        raise SystemExit(
            f"{arguments.algo} on {env_id}: no settings; known are {', '.join(map(' on '.join, SETTINGS))}"
        )
    keywords = dict(_KEYWORDS.get(kind, {}))
    settings = dict(SETTINGS[kind, arguments.algo])
    if arguments.batch_size:
        settings["batch_size"] = arguments.batch_size
    if arguments.net:
        settings["policy_kwargs"] = {**settings.get("policy_kwargs", {}), "net_arch": list(arguments.net)}
    if arguments.algo in ("sac", "tqc", "dqn"):
        settings |= {"train_freq": 1, "gradient_steps": arguments.gradient_steps}
    copies = make_vec_env(
        partial(gym.make, env_id, **keywords),
        n_envs=arguments.num_envs,
        seed=arguments.seed,
        vec_env_cls=SubprocVecEnv if arguments.processes else DummyVecEnv,
    )
    network = "MultiInputPolicy" if isinstance(copies.observation_space, gym.spaces.Dict) else "MlpPolicy"
    model = LEARNERS[arguments.algo](network, copies, seed=arguments.seed, device=arguments.device, **settings)
    judges = make_vec_env(partial(gym.make, env_id, **keywords), n_envs=min(_AT_ONCE, arguments.episodes))
    model.learn(arguments.steps, callback=Evaluations(arguments, judges, settings))


class Evaluations(BaseCallback):  # type: ignore[misc]  # Stable-Baselines3 is skipped by mypy
    """Plays the held-out scenes before the first step, every so many steps and at the end; writes curve and actor."""

    def __init__(self, arguments: Arguments, judges: VecEnv, settings: Mapping[str, Any]) -> None:
        super().__init__()
        self._arguments, self._judges = arguments, judges
        self._settings = {name: getattr(value, "__name__", value) for name, value in settings.items()}
        self._points: list[dict[str, float]] = []
        self._next = 0

    def _on_training_start(self) -> None:
        self._started, self._started_cpu = time.perf_counter(), time.process_time()
        self._evaluate()

    def _on_step(self) -> bool:
        if self.num_timesteps >= self._next:
            self._evaluate()
        minutes = self._arguments.minutes
        return not minutes or time.perf_counter() - self._started < 60 * minutes

    def _on_training_end(self) -> None:
        if self._points[-1]["steps"] < self.num_timesteps:
            self._evaluate()

    def _evaluate(self) -> None:
        arguments = self._arguments
        self._next += arguments.every
        success = held_out_success(self.model, self._judges, arguments.episodes)
        self._points.append(
            {
                "steps": self.num_timesteps,
                "updates": int(getattr(self.model, "_n_updates", 0)),
                "success": success,
                "wall_s": round(time.perf_counter() - self._started, 1),
                "cpu_s": round(time.process_time() - self._started_cpu, 1),
            }
        )
        name = f"{arguments.env.removesuffix('-v0')}-{arguments.algo}-{arguments.seed}"
        arguments.out.mkdir(parents=True, exist_ok=True)
        about = {**asdict(arguments), "out": name, "settings": self._settings, "points": self._points}
        (arguments.out / f"{name}.json").write_text(json.dumps(about, indent=1))
        policy = self.model.policy
        weights = getattr(policy, "actor", None) or policy
        np.savez(arguments.out / f"{name}.npz", **{key: value.cpu() for key, value in weights.state_dict().items()})
        print(name, self._points[-1], flush=True)


def held_out_success(model: BaseAlgorithm, judges: VecEnv, episodes: int) -> float:
    """The share of the held-out scenes on which the most probable actions end an episode with success."""
    successes = 0
    for first in range(0, episodes, judges.num_envs):
        judges.seed(HELD_OUT + first)
        observations, is_over = judges.reset(), np.zeros(judges.num_envs, bool)
        while not is_over.all():
            options = {"action_masks": get_action_masks(judges)} if isinstance(model, MaskablePPO) else {}
            actions, _ = model.predict(observations, deterministic=True, **options)
            observations, _, dones, infos = judges.step(actions)
            for index in np.flatnonzero(dones & ~is_over):
                successes += bool(infos[index]["is_success"]) and first + int(index) < episodes
            is_over |= dones
    return successes / episodes


if __name__ == "__main__":
    main(tyro.cli(Arguments))
