"""Play the decisions of a trained decider without physics, on the scenes of a suite.

    python -m clutter_env.cli.data.check_decisions --model assets/policies/decisions-side.npz

A contact succeeds if it is free by the planner's geometry; the first one that is not ends the episode. Prints the share
of the scenes in which the target is taken, and the mean number of clearances beside the minimum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from clutter_env.reporting.command import run_command
from clutter_env.reporting.progress import progress_bar


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    model: Path
    """Weights of the decider."""
    suite: str = "side-15-v1"
    """Name of the suite."""
    split: str = "validation"
    """Scenes of the suite: "test", or "validation", on which policies may be tuned."""
    scenes: int = 100
    """How many of them, from the first on."""
    json: Path | None = None
    """Write the results to this file."""


def run(arguments: Arguments) -> None:
    """Play and print."""
    from clutter_env.learning.decisions.decider import LearnedDecider
    from clutter_env.learning.decisions.evaluation import score
    from clutter_env.learning.decisions.examples import scene_of
    from clutter_env.learning.decisions.kinematic import simulate_decisions
    from clutter_env.reporting.files import write_json
    from clutter_env.suites import suite

    decider = LearnedDecider.load(arguments.model)
    outcomes, floors = [], []
    for scene in progress_bar(suite(arguments.suite).split(arguments.split)[: arguments.scenes], unit="scene"):
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
    if arguments.json is not None:
        write_json(arguments.json, found)


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("check_decisions", Arguments, run, __doc__, words)


if __name__ == "__main__":
    main()
