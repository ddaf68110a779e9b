"""Reinforcement learning from a staged reward alone: stock SAC on ArmPick, without demonstrations and hindsight.

    python scripts/arm_pick_staged.py [SEED [STEPS]]

Lengths are in units of 0.1 m, and the goal is relative to the object. The settings are those of `clutter-env train sac`
on ArmRetrieve, but for two updates after four steps. Printed are successes in held-out scenes, and what each term of
the reward earned a step in the training since the line before.
"""

import sys
import time
from collections.abc import Mapping
from statistics import fmean
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import ConvertCallback, EveryNTimesteps
from stable_baselines3.common.env_util import make_vec_env

from clutter_env.envs.staged_pick import PICK_WEIGHTS
from clutter_env.evaluation.score import success_rate
from clutter_env.policies.reinforcement import ModelPolicy
from clutter_env.seeds import HELD_OUT
from clutter_env.task import Task

SEED, STEPS = (*map(int, sys.argv[1:]), *(0, 100_000)[len(sys.argv) - 1 :])
WATCHED, MEASURED = range(HELD_OUT, HELD_OUT + 20), range(HELD_OUT + 10_000, HELD_OUT + 10_100)
"""Seeds of held-out scenes: played on the way, and at the end alone."""
LENGTHS = ("tcp_position", "width", "commanded_width", "object_position", "tcp_to_object", "half_extents")
COPIES = 4
"""Copies of the environment: two updates for four steps cost half of what one for each costs."""
SETTINGS = {
    "learning_rate": 1e-3,
    "gamma": 0.95,
    "tau": 0.01,
    "learning_starts": 1000,
    "gradient_steps": 2,
    "ent_coef": "auto_0.1",
    "target_entropy": -2.0,
    "policy_kwargs": {"net_arch": [128, 128]},
}


class Relative(gym.ObservationWrapper[Any, Any, Any]):
    """An observation as one vector: its entry "observation", and the goal relative to the object; units of 0.1 m."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        (columns,) = env.get_wrapper_attr("observation_layout").values()
        self._scale = np.ones(columns.size)
        for name in LENGTHS:
            self._scale[columns[name]] = 10.0
        self._scale[columns["object_angular_velocity"]] = 0.1
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (columns.size + 3,), np.float32)

    def observation(self, observation: Any) -> Any:
        """The vector."""
        ahead = 10.0 * (observation["desired_goal"] - observation["achieved_goal"])
        return np.append(self._scale * observation["observation"], ahead).astype(np.float32)


def make() -> gym.Env[Any, Any]:
    """The environment with the observation of here."""
    return Relative(task.make())


def measure(seeds: range) -> bool:
    success, spent = success_rate(env, ModelPolicy("sac", model), seeds), time.process_time() - started
    terms = [f"{name} {fmean(each[name] for each in earned):.3f}" for name in PICK_WEIGHTS if earned]
    print(
        f"{model.num_timesteps} steps, {spent:.0f} CPU s: {success:.2f} of {len(seeds)} {', '.join(terms)}", flush=True
    )
    earned.clear()
    return True


def note(local: Mapping[str, Any], _: Any) -> bool:
    """Note what the terms earn in a step of the training."""
    earned.extend(info["reward_terms"] for info in local["infos"])
    return True


torch.set_num_threads(1)
started, task = time.process_time(), Task("clutter_env/ArmPick-v0", {"reward_mode": "staged"})
earned: list[Mapping[str, float]] = []
env = make()
print(f"{task.env_id}, staged reward, seed {SEED}, {SETTINGS}", flush=True)
model = SAC("MlpPolicy", make_vec_env(make, COPIES, SEED), buffer_size=STEPS, seed=SEED, **SETTINGS)
watching = EveryNTimesteps(max(STEPS // 16, 1), ConvertCallback(lambda *_: measure(WATCHED)))
model.learn(STEPS, callback=[ConvertCallback(note), watching])
measure(MEASURED)
model.save("armpick_staged_sac.zip")
