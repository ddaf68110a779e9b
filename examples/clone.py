"""Clone a scripted expert: forty demonstrations of Pick, one network, one minute."""

import torch

from clutter_env.data.episode import record
from clutter_env.evaluation.score import held_out_seeds, success_rate
from clutter_env.policies.experts import make_expert
from clutter_env.task import Task
from clutter_env.training.cloning import clone, examples_of

torch.set_num_threads(1)
task = Task("clutter_env/Pick-v0")
env = task.make()
episodes = [record(task, env, make_expert("pick"), seed) for seed in range(40)]
print(f"{sum(episode.succeeded for episode in episodes)} of {len(episodes)} demonstrations succeed")

examples = examples_of(episode for episode in episodes if episode.succeeded)
policy = clone(examples, steps=3000, report=lambda step, loss: print(f"step {step}: loss {loss:.4f}"))
print("success of the clone:", success_rate(env, policy, held_out_seeds(20)))
env.close()
