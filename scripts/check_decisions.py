"""Play the decisions of a trained decider without physics, on the scenes of a suite.

    python scripts/check_decisions.py --model assets/policies/decisions-side.npz

A contact succeeds if it is free by the planner's geometry; the first one that is not ends the episode. Prints the share
of the scenes in which the target is taken, and the mean number of clearances beside the minimum.
"""

from __future__ import annotations

from pathlib import Path

import tyro

from clutter_env.reporting.progress import progress_bar


def main(
    model: Path, suite: str = "side-15-v1", split: str = "validation", scenes: int = 100, json: Path | None = None
) -> None:
    """Play and print.

    Args:
        model: Weights of the high-level policy.
        suite: Name of the suite.
        split: Scenes of the suite: "test", or "validation", on which policies may be tuned.
        scenes: Number of scenes, from the first on.
        json: Write the results to this file.
    """
    from clutter_env.learning.decisions.decider import LearnedDecider
    from clutter_env.learning.decisions.evaluation import score
    from clutter_env.learning.decisions.examples import scene_of
    from clutter_env.learning.decisions.kinematic import simulate_decisions
    from clutter_env.reporting.files import write_json
    from clutter_env.suites import suite as find_suite

    decider = LearnedDecider.load(model)
    outcomes, floors = [], []
    for scene in progress_bar(find_suite(suite).split(split)[:scenes], unit="scene"):
        env = scene.make()
        _, info = scene.reset(env)
        outcomes.append(simulate_decisions(decider, scene_of(env), str(info["target"])))
        floor = scene.floor_side if decider.rule.grasps == "side" else scene.floor_all
        floors.append(None if floor is None else floor.count)
        env.close()
    found = score(outcomes, floors)
    print(f"taken {found.taken:.2f} of {found.scenes}, clearances {found.clearances:.2f}, floor {found.floor:.2f}")
    for failure, count in found.failures:
        print(f"  {failure}: {count}")
    if json is not None:
        write_json(json, found)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
