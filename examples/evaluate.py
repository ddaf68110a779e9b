"""Compare two policies on the same held-out scenes, with 95% intervals."""

from clutter_env.learning.comparison.evaluation import held_out_seeds, play
from clutter_env.learning.comparison.tables import markdown, summarise
from clutter_env.learning.policies.baselines import greedy_agent, random_agent
from clutter_env.learning.task import Task

SCENES = 5
env = Task("clutter_env/Skill-o10-v0").make()
policies = {"random": random_agent(env, seed=0), "greedy": greedy_agent(env)}
rows = [
    summarise("o10", name, [[play(env, act, seed) for seed in held_out_seeds(SCENES)]], floors={}, seed=0)
    for name, act in policies.items()
]
print(markdown(rows))
env.close()
