"""Compare two policies on the same held-out scenes, with 95% intervals."""

from clutter_env.evaluation.evaluate import evaluate
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.tables import markdown, summarise

if __name__ == "__main__":  # the processes of `evaluate` import this file
    scenes = SceneSet(env_id="clutter_env/Skill-o10-v0", count=5)
    rows = []
    for name in ("random-skills", "greedy"):
        rows.append(summarise(name, [evaluate(name, scenes)]))
    print(markdown(rows))
