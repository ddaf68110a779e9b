"""Compare two policies on the same held-out scenes, with 95% intervals."""

from clutter_env.evaluation.score import DrawnScene, held_out_seeds, play_scene
from clutter_env.evaluation.tables import markdown, summarise
from clutter_env.policies.baselines import GreedyPolicy, RandomPolicy
from clutter_env.task import Task

SCENES = 5
env = Task("clutter_env/Skill-o10-v0").make()
policies = {"random": RandomPolicy(seed=0, acts_by_skills=True), "greedy": GreedyPolicy()}
rows = [
    summarise(
        "o10",
        name,
        [[play_scene(DrawnScene(seed), env, policy) for seed in held_out_seeds(SCENES)]],
        floors={},
        seed=0,
    )
    for name, policy in policies.items()
]
print(markdown(rows))
env.close()
