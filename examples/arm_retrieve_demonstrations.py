"""Reinforcement learning from demonstrations, in the style of RLPD (Ball et al. 2023): stock SAC on ArmRetrieve.

    python arm_retrieve_demonstrations.py [OBJECTS [SEED [STEPS [DEMONSTRATIONS]]]]

A script's demonstrations fill the replay buffer before the first step; the reward is the staged one. 20,000 steps with
one object take six CPU minutes.
"""

import sys
import time

import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import ConvertCallback, EveryNTimesteps
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.utils import LinearSchedule

from clutter_env.data.episode import record
from clutter_env.evaluation.score import success_rate
from clutter_env.policies.experts import make_expert
from clutter_env.policies.reinforcement import ModelPolicy
from clutter_env.seeds import HELD_OUT
from clutter_env.task import Task

OBJECTS, SEED, STEPS, DEMONSTRATIONS = (*map(int, sys.argv[1:]), *(1, 0, 20_000, 300)[len(sys.argv) - 1 :])
WATCHED, MEASURED = range(HELD_OUT, HELD_OUT + 20), range(HELD_OUT + 10_000, HELD_OUT + 10_100)
"""Seeds of held-out scenes: played on the way, and at the end alone."""
SETTINGS = {
    "learning_rate": LinearSchedule(1e-3, 1e-4, 1.0),
    "gamma": 0.95,
    "tau": 0.01,
    "batch_size": 256,
    "ent_coef": "auto_0.1",
    "learning_starts": 0,
    "policy_kwargs": {"net_arch": [128, 128]},
}


def measure(seeds):
    success, spent = success_rate(env, ModelPolicy("sac", model), seeds), time.process_time() - started
    print(f"{model.num_timesteps} steps, {spent:.0f} CPU s: {success:.2f} of {len(seeds)}", flush=True)
    return True


torch.set_num_threads(1)
started, task = time.process_time(), Task(f"clutter_env/ArmRetrieve-o{OBJECTS}-v0")
env = task.make()
episodes = [record(task, env, make_expert("armretrieve"), seed) for seed in range(DEMONSTRATIONS)]
episodes = [episode for episode in episodes if episode.succeeded]
print(f"{task.env_id}, {len(episodes)} demonstrations, seed {SEED}, {SETTINGS}", flush=True)
size = STEPS + sum(map(len, episodes))
model = SAC("MultiInputPolicy", make_vec_env(task.make, seed=SEED), buffer_size=size, seed=SEED, **SETTINGS)
for episode in episodes:
    seen = episode.observations["observation"]
    for t, action in enumerate(np.clip(episode.actions, -1, 1)):
        row, after = {"observation": seen[[t]]}, {"observation": seen[[t + 1]]}
        done = np.array([t + 1 == len(episode)])
        model.replay_buffer.add(row, after, action[None], episode.rewards[[t]], done, [{}])
model.learn(STEPS, callback=EveryNTimesteps(max(STEPS // 5, 1), ConvertCallback(lambda *_: measure(WATCHED))))
measure(MEASURED)
model.save(f"arm_retrieve_o{OBJECTS}_sac.zip")
