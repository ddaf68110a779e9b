"""A reverse curriculum (Florensa et al. 2017, Tao et al. 2024) with stock SAC: rewards at success, demonstrated starts.

    python reverse_curriculum.py [OBJECTS [SEED [STEPS [DEMONSTRATIONS]]]]

Episodes begin in states of a script's demonstrations, first near the end; as soon as most of them succeed, earlier. No
action of a demonstration is used, and the reward is 1 at success alone.
"""

import sys
import time
from collections import deque

import torch
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import ConvertCallback, EveryNTimesteps

from clutter_env.data.episode import record
from clutter_env.data.resets import FromDemonstrations, demonstration_resets
from clutter_env.evaluation.score import success_rate
from clutter_env.policies.experts import make_expert
from clutter_env.policies.reinforcement import ModelPolicy
from clutter_env.seeds import HELD_OUT
from clutter_env.task import Task

OBJECTS, SEED, STEPS, DEMONSTRATIONS = (*map(int, sys.argv[1:]), *(1, 0, 40_000, 100)[len(sys.argv) - 1 :])
WATCHED, MEASURED = range(HELD_OUT, HELD_OUT + 20), range(HELD_OUT + 10_000, HELD_OUT + 10_100)
"""Seeds of held-out scenes: played on the way, and at the end alone."""
SETTINGS = {
    "learning_rate": 1e-3,
    "gamma": 0.95,
    "tau": 0.01,
    "batch_size": 256,
    "ent_coef": "auto_0.01",
    "learning_starts": 500,
    "policy_kwargs": {"net_arch": [128, 128]},
}
LATEST, WIDEN, ENOUGH, OF = 14, 1.15, 0.8, 20
"""Steps before the end at first; by what they grow when so many of the last episodes were successes."""


def measure(seeds):
    success, spent = success_rate(env, ModelPolicy("sac", model), seeds), time.process_time() - started
    text = f"{model.num_timesteps} steps, {spent:.0f} CPU s, within {training.within:.0f}"
    print(f"{text}: {success:.2f} of {len(seeds)}", flush=True)
    return True


def widen(local, _):
    """Begin earlier when most of the last episodes were successes; at last in whole scenes too."""
    for done, info in zip(local["dones"], local["infos"], strict=True):
        if done:
            recent.append(info["is_success"])
    if len(recent) == OF and sum(recent) >= ENOUGH * OF:
        recent.clear()
        training.within = min(int(training.within * WIDEN) + 1, longest)
        training.share = 0.5 if training.within == longest else 0.9
    return True


torch.set_num_threads(1)
started, task = time.process_time(), Task(f"clutter_env/ArmRetrieve-o{OBJECTS}-v0", {"reward_mode": "sparse"})
env, recent = task.make(), deque(maxlen=OF)
episodes = [record(task, env, make_expert("armretrieve"), seed) for seed in range(DEMONSTRATIONS)]
longest = max(map(len, episodes))
resets = demonstration_resets(episode for episode in episodes if episode.succeeded)
training = FromDemonstrations(task.make(), resets, share=0.9, within=LATEST)
training.reset(seed=SEED)
print(f"{task.env_id}, {len(resets.episodes)} demonstrations, seed {SEED}, {SETTINGS}", flush=True)
model = SAC("MultiInputPolicy", training, buffer_size=STEPS, seed=SEED, **SETTINGS)
measuring = EveryNTimesteps(max(STEPS // 8, 1), ConvertCallback(lambda *_: measure(WATCHED)))
model.learn(STEPS, callback=[measuring, ConvertCallback(widen)])
measure(MEASURED)
