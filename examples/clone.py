"""Behaviour cloning with PyTorch alone: forty demonstrations of a scripted expert, one network, held-out scenes."""

import numpy as np
import torch

from clutter_env.data.episode import record
from clutter_env.evaluation.score import success_rate
from clutter_env.policies.experts import make_expert
from clutter_env.seeds import held_out_seeds
from clutter_env.task import Task


def features(observation):
    """The observation, and the offset from achieved to desired goal at two scales (..., f)."""
    offset = observation["desired_goal"] - observation["achieved_goal"]
    vector = np.concatenate((observation["observation"], offset, np.tanh(20 * offset)), axis=-1)
    return torch.from_numpy(vector.astype(np.float32))


class Clone:
    """A policy; `clutter-env evaluate --policy module:Class` takes such a class too."""

    def __init__(self, network):
        self.network = network

    def reset(self, info):
        """Start an episode; nothing is remembered of the last one."""

    def act(self, observation):
        with torch.no_grad():
            return self.network(features(observation)).numpy()


torch.manual_seed(0)
torch.set_num_threads(1)
task = Task("clutter_env/ArmPick-v0")
env = task.make()
episodes = [record(task, env, make_expert("armpick"), seed) for seed in range(40)]
shown = torch.cat([features(episode.observations)[:-1] for episode in episodes if episode.succeeded])
actions = torch.cat([torch.from_numpy(episode.actions) for episode in episodes if episode.succeeded])

layers = [torch.nn.Linear(shown.shape[1], 256), torch.nn.ReLU(), torch.nn.Linear(256, 256), torch.nn.ReLU()]
network = torch.nn.Sequential(*layers, torch.nn.Linear(256, actions.shape[1]), torch.nn.Tanh())
optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
for step in range(4000):
    chosen = torch.randint(len(shown), (512,))
    loss = torch.nn.functional.smooth_l1_loss(network(shown[chosen]), actions[chosen], beta=0.1)
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()
    if step % 1000 == 999:
        print(f"step {step + 1}: loss {loss.item():.4f}")
print("success of the clone:", success_rate(env, Clone(network), held_out_seeds(20)))
env.close()
