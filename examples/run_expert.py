"""Let the task and motion planner retrieve the target from among 15 objects."""

import gymnasium as gym

import clutter_env  # noqa: F401  registers the environments
from planners import TampExpert

env = gym.make("clutter_env/Retrieve-o15-v0", obstructed=True)
_, info = env.reset(seed=3)
print("target:", info["target"])

expert = TampExpert(env, strategy="lookahead", grasps="side")
expert.reset(info["target"])
while not expert.done:
    _, _, terminated, truncated, info = env.step(expert.act())
    if terminated or truncated:
        break

for action in expert.solution.actions:
    print(action)
print("success:", info["is_success"], "cleared:", expert.report.clearances, "lower bound:", expert.report.floor)
env.close()
