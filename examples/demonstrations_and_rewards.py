"""Reinforcement learning that begins with demonstrations: stock SAC with hindsight, on ArmPick.

    python demonstrations_and_rewards.py [SEED [STEPS [DEMONSTRATIONS]]]

A script's demonstrations, at least one, fill the replay buffer before the first step. 80,000 steps take 20 minutes.
"""

import sys
import time

import numpy as np
import torch
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.callbacks import ConvertCallback, EveryNTimesteps
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

from clutter_env.data.episode import record
from clutter_env.evaluation.score import success_rate
from clutter_env.policies.experts import make_expert
from clutter_env.seeds import held_out_seeds
from clutter_env.task import Task

SEED, STEPS, DEMONSTRATIONS = (*map(int, sys.argv[1:]), *(0, 80_000, 1000)[len(sys.argv) - 1 :])


class Learned:
    """What has been learned, as a policy."""

    def reset(self, info): ...
    def act(self, observation):
        return model.predict(envs.normalize_obs(observation), deterministic=True)[0]


def measure(*_):
    success = success_rate(env, Learned(), held_out_seeds(200))
    print(f"{model.num_timesteps} steps, {time.process_time() - started:.0f} CPU s: success {success:.2f}", flush=True)
    return True


torch.set_num_threads(1)
started, task = time.process_time(), Task("clutter_env/ArmPick-v0")
env, envs = task.make(), VecNormalize(make_vec_env(task.make, seed=SEED), norm_reward=False)
options = {"learning_rate": lambda left: 1e-3 * left + 1e-5, "gamma": 0.95, "tau": 0.02, "ent_coef": "auto_0.05"}
buffer = {"replay_buffer_class": HerReplayBuffer, "buffer_size": 50 * DEMONSTRATIONS + STEPS, "learning_starts": 0}
network = {"policy_kwargs": {"net_arch": [256, 256]}, "batch_size": 256, "seed": SEED}
model = SAC("MultiInputPolicy", envs, **options, **buffer, **network)
for seed in range(DEMONSTRATIONS):
    episode = record(task, env, make_expert("armpick"), seed)
    for name, values in episode.observations.items():
        envs.obs_rms[name].update(values)
    rows = [{name: values[[t]] for name, values in episode.observations.items()} for t in range(len(episode) + 1)]
    for t, action in enumerate(np.clip(episode.actions, -1, 1)):
        last = t + 1 == len(episode)
        told = {"TimeLimit.truncated": last}
        model.replay_buffer.add(rows[t], rows[t + 1], action[None], episode.rewards[[t]], np.array([last]), [told])
envs.training = False  # observations keep the scale that they have in the demonstrations
model.learn(STEPS, callback=EveryNTimesteps(STEPS // 4, ConvertCallback(measure)))
model.save("armpick_sac.zip")
envs.save("armpick_scale.pkl")
