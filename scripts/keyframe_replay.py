"""How often the keyframes of the expert's demonstrations alone do the task, and in how many decisions.

python -m scripts.keyframe_replay --objects 5 --scenes 20
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import tyro

from clutter_env.data.episode import record
from clutter_env.data.keyframes import keyframe_steps
from clutter_env.envs.keyframe_actions import KeyframeActions
from clutter_env.policies.experts import find_expert, make_expert
from clutter_env.reporting.tables import markdown_table
from clutter_env.task import Task

AGAIN = 3
"""Times that the last keyframe is repeated: there the target is held up."""


@dataclass(frozen=True)
class Replay:
    """A demonstration and its keyframes, gone for one after the other: steps, decisions, and what came of them."""

    demonstrated: int
    decisions: int
    steps: int
    end: str


def main(
    objects: int = 5, scenes: int = 20, every: int | None = None, obstructed: bool = False, first: int = 0
) -> None:
    """Record the demonstrations, follow their keyframes, and print a table.

    Args:
        objects: In each scene.
        scenes: Number of scenes.
        every: Steps after which there is a keyframe between those of the plan; none if it is not given.
        obstructed: Only scenes whose target no side grasp reaches without moving something.
        first: Seed of the first scene.
    """
    task = Task(f"clutter_env/Retrieve-o{objects}-v0", {"obstructed": True} if obstructed else {})
    found = [each for seed in range(first, first + scenes) if (each := replay(task, seed, every))]
    ends = [each.end for each in found]
    counts = ", ".join(f"{end} {ends.count(end)}" for end in sorted(set(ends), key=lambda end: -ends.count(end)))
    means = np.mean([(each.demonstrated, each.decisions, each.steps) for each in found], axis=0)
    heads = ("demonstrations", "their steps", "decisions", "steps by keyframes", "ends")
    print(markdown_table(heads, [(f"{len(found)} of {scenes}", *(f"{mean:.0f}" for mean in means), counts)]), end="")


def replay(task: Task, seed: int, every: int | None) -> Replay | None:
    """A scene's demonstration and its keyframes; None if the expert fails."""
    env = task.make()
    episode = record(task, env, make_expert(find_expert(task.env_id)), seed)
    if not episode.succeeded:
        return None
    keyframes = keyframe_steps(episode, every).keyframes
    by_keyframes = KeyframeActions(env)
    _, info = by_keyframes.reset(seed=seed)
    steps = decisions = 0
    for keyframe in [*keyframes, *[keyframes[-1]] * AGAIN]:
        _, _, terminated, truncated, info = by_keyframes.step(keyframe)
        steps, decisions = steps + info["control_steps"], decisions + 1
        if terminated or truncated:
            break
    if info["is_success"]:
        end = "success"
    else:
        end = "disturbed" if info["num_disturbed"] or info["num_fallen"] else "lifted" if info["lifted"] else "not held"
    return Replay(len(episode), decisions, steps, end)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
