"""Reinforcement learning from a staged reward alone: stock SAC on ArmPick, without demonstrations and hindsight.

    python scripts/arm_pick_staged.py [SEED [STEPS [REFILL]]]

Observations are normalised as they come. The settings are those of `clutter-env train sac` on ArmRetrieve, but for two
updates after four steps. Printed are successes in held-out scenes, and what each term of the reward earned a step in
the training since the line before. With REFILL it goes on from the files that the last run left here: the replay buffer
is not among them, so REFILL steps come first without updates.
"""

import sys
import time
from collections.abc import Mapping
from statistics import fmean
from typing import Any

import torch
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import ConvertCallback, EveryNTimesteps
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

from clutter_env.envs.staged_pick import PICK_WEIGHTS
from clutter_env.evaluation.score import success_rate
from clutter_env.seeds import HELD_OUT
from clutter_env.task import Task

SEED, STEPS, REFILL = (*map(int, sys.argv[1:]), *(0, 80_000, 0)[len(sys.argv) - 1 :])
MODEL, SCALE = "armpick_staged_sac.zip", "armpick_staged_scale.pkl"
WATCHED, MEASURED = range(HELD_OUT, HELD_OUT + 20), range(HELD_OUT + 10_000, HELD_OUT + 10_100)
"""Seeds of held-out scenes: played on the way, and at the end alone."""
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


class Learned:
    """What has been learned, as a policy."""

    def reset(self, info: Mapping[str, Any]) -> None:
        """Nothing is remembered."""

    def act(self, observation: Any) -> Any:
        """The most likely action."""
        return model.predict(envs.normalize_obs(observation), deterministic=True)[0]


def measure(seeds: range) -> bool:
    success, spent = success_rate(env, Learned(), seeds), time.process_time() - started
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
env, envs = task.make(), make_vec_env(task.make, COPIES, SEED)
print(f"{task.env_id}, staged reward, seed {SEED}, {SETTINGS}", flush=True)
if REFILL:
    envs = VecNormalize.load(SCALE, envs)
    model = SAC.load(MODEL, envs, buffer_size=STEPS, gradient_steps=0, seed=SEED + 1000)  # other scenes
    model.learn(REFILL, reset_num_timesteps=False)
    model.gradient_steps = SETTINGS["gradient_steps"]
else:
    envs = VecNormalize(envs, norm_reward=False)
    model = SAC("MultiInputPolicy", envs, buffer_size=STEPS, seed=SEED, **SETTINGS)
watching = EveryNTimesteps(max(STEPS // 16, 1), ConvertCallback(lambda *_: measure(WATCHED)))
model.learn(STEPS - REFILL, callback=[ConvertCallback(note), watching], reset_num_timesteps=not REFILL)
measure(MEASURED)
model.save(MODEL)
envs.save(SCALE)
