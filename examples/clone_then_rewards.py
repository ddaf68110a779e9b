"""Reinforcement learning that begins as a clone: stock PPO on ArmRetrieve, with 1 at success as its only reward.

    python clone_then_rewards.py [OBJECTS [SEED [STEPS [DEMONSTRATIONS]]]]

Policy and value function are fitted to a script's demonstrations; then PPO goes on from there, with little noise. With
several objects observations say what is in the way (`roles`), which the environment knows from its exact state.
"""

import sys
import time

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import ConvertCallback, EveryNTimesteps
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.utils import LinearSchedule, set_random_seed
from torch.nn.functional import l1_loss, mse_loss

from clutter_env.data.episode import record
from clutter_env.evaluation.score import success_rate
from clutter_env.policies.experts import make_expert
from clutter_env.policies.reinforcement import ModelPolicy
from clutter_env.seeds import HELD_OUT
from clutter_env.task import Task

OBJECTS, SEED, STEPS, DEMONSTRATIONS = (*map(int, sys.argv[1:]), *(3, 0, 102_400, 1200)[len(sys.argv) - 1 :])
WATCHED, MEASURED = range(HELD_OUT, HELD_OUT + 20), range(HELD_OUT + 10_000, HELD_OUT + 10_100)
"""Seeds of held-out scenes: played on the way, and at the end alone."""
SETTINGS = {
    "learning_rate": LinearSchedule(1e-4, 1e-5, 1.0),
    "gamma": 0.99,
    "n_steps": min(2048, STEPS),
    "batch_size": 256,
    "policy_kwargs": {
        "net_arch": {"pi": [256, 256], "vf": [256, 256]},
        "activation_fn": torch.nn.ReLU,
        "log_std_init": -2.5,
        "ortho_init": False,
    },
}
MOST_UPDATES, BATCH = 20_000, 256
"""Of the fit to the demonstrations; at most ten updates for each of their steps."""


def fit(policy, episodes):
    """Fit the mean action to the demonstrated ones, and the value to the discounted success."""
    seen = torch.tensor(np.concatenate([each.observations["observation"][:-1] for each in episodes]))
    actions = torch.tensor(np.clip(np.concatenate([each.actions for each in episodes]), -1, 1)).float()
    left = np.concatenate([np.arange(len(each))[::-1] for each in episodes])
    values, updates = torch.tensor(SETTINGS["gamma"] ** left).float(), min(MOST_UPDATES, 10 * len(left))
    optimiser = torch.optim.Adam([each for name, each in policy.named_parameters() if name != "log_std"], 1e-3)
    schedule = torch.optim.lr_scheduler.LinearLR(optimiser, 1.0, 0.02, updates)
    set_random_seed(SEED)
    for update in range(updates):
        drawn = torch.randint(0, len(left), (BATCH,))
        observation = {"observation": seen[drawn]}
        error = l1_loss(policy.get_distribution(observation).distribution.mean, actions[drawn])
        if update % 2 == 0:
            error = error + mse_loss(policy.predict_values(observation)[:, 0], values[drawn])
        optimiser.zero_grad()
        error.backward()
        optimiser.step()
        schedule.step()


def measure(seeds):
    success, spent = success_rate(env, ModelPolicy("ppo", model), seeds), time.process_time() - started
    print(f"{model.num_timesteps} steps, {spent:.0f} CPU s: {success:.2f} of {len(seeds)}", flush=True)
    return True


torch.set_num_threads(1)
options = {"roles": OBJECTS > 1, "reward_mode": "sparse"}
started, task = time.process_time(), Task(f"clutter_env/ArmRetrieve-o{OBJECTS}-v0", options)
env = task.make()
episodes = [record(task, env, make_expert("armretrieve"), seed) for seed in range(DEMONSTRATIONS)]
episodes = [episode for episode in episodes if episode.succeeded]
print(f"{task.env_id}, {options}, {len(episodes)} demonstrations, seed {SEED}, {SETTINGS}", flush=True)
model = PPO("MultiInputPolicy", make_vec_env(task.make, seed=SEED), seed=SEED, **SETTINGS)
fit(model.policy, episodes)
measure(WATCHED)
set_random_seed(SEED)
model.learn(STEPS, callback=EveryNTimesteps(max(STEPS // 5, 1), ConvertCallback(lambda *_: measure(WATCHED))))
measure(MEASURED)
model.save(f"arm_retrieve_o{OBJECTS}_ppo.zip")
