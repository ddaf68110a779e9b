"""Train the weights of `keyframes`, `keyframes-all` or `keyframes-shelf` anew, and play a suite with them.

    clutter-env collect --env clutter_env/Retrieve-o15-v0 --obstructed --strategy canonical --episodes 100 \
        --out outputs/demos/o15-canonical
    python -m scripts.shipped_weights side --demos outputs/demos/o15-canonical
    python -m scripts.shipped_weights all --seed 1

Decisions are learned from the planner's geometry, motions from demonstrations or, without --demos, from canonical plans
of which nothing is simulated. The directory gets decisions.npz and motions.npz; those of the package are
assets/policies/decisions-*.npz and keyframes-*.npz. What is there already is not made again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
import tyro

from clutter_env.data.dataset import Dataset
from clutter_env.evaluation.evaluate import evaluate
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.tables import markdown, summarise
from clutter_env.policies.high_level.candidates import CandidateRule
from clutter_env.policies.high_level.policy import LearnedHighLevelPolicy
from clutter_env.policies.motion.keyframe_policy import KeyframePolicy
from clutter_env.policies.two_level import TwoLevelPolicy
from clutter_env.policies.weights import save_weights, trained_in
from clutter_env.seeds import training_seeds
from clutter_env.task import Task
from scripts.shipped_weights.decisions import SEEDS_OF_A_RUN, DecisionBudget, train_decisions
from scripts.shipped_weights.motion_examples import Motion, motions_of, planned_motions
from scripts.shipped_weights.motions import fit_motions

FIRST_PLAN_SEED = 100_000
"""First seed of the scenes whose plans are learned from."""


@dataclass(frozen=True)
class Recipe:
    """How the weights for a problem are made.

    Attributes:
        task: environment in which scenes are drawn.
        grasps: name of the grasp set.
        suite: on which they are measured.
        decisions: how much is learned for decisions.
        motion_steps: gradient steps for motions.
        plans: scenes whose plans are learned from, where there are no demonstrations.
    """

    task: Task
    grasps: str
    suite: str
    decisions: DecisionBudget
    motion_steps: int
    plans: int = 600


RECIPES = {
    "side": Recipe(
        Task("clutter_env/Retrieve-o15-v0", {"obstructed": True}),
        "side",
        "side-15-v3",
        DecisionBudget(scenes=700, rounds=2),
        motion_steps=8000,
    ),
    "all": Recipe(
        Task("clutter_env/Retrieve-o25-v0"), "all", "all-25-v3", DecisionBudget(scenes=220), motion_steps=6000
    ),
    "shelf": Recipe(
        Task("clutter_env/Retrieve-o10-v0", {"layout": "shelf", "obstructed": True}),
        "side",
        "shelf-10-v4",
        DecisionBudget(scenes=200),
        motion_steps=5000,
        plans=348,
    ),
}
"""Those of the package, by problem; for "side" with 100 canonical demonstrations."""


@dataclass(frozen=True)
class Arguments:
    """Train weights of both levels."""

    problem: tyro.conf.Positional[Literal["side", "all", "shelf"]]
    """Level grasps, all grasps, or level ones under a shelf."""
    demos: Path | None = None
    """Dataset of `clutter-env collect`; without it plans are learned from."""
    seed: int = 0
    """Random seed."""
    split: Literal["test", "validation"] = "validation"
    """Split of the suite on which the policy is measured."""
    scenes: int = 20
    """Number of its scenes."""
    out: Path | None = None
    """Directory; outputs/weights/PROBLEM-SEED if not given."""


def main(arguments: Arguments) -> None:
    """Train, then play a suite."""
    torch.set_num_threads(1)
    recipe = RECIPES[arguments.problem]
    out = arguments.out or Path(f"outputs/weights/{arguments.problem}-{arguments.seed}")
    policy = train(recipe, out, arguments.seed, arguments.demos, print)
    scenes = SceneSet(recipe.suite, arguments.split, count=arguments.scenes)
    print(markdown([summarise(str(out), [evaluate(policy, scenes)])]))


def train(
    recipe: Recipe,
    directory: Path,
    seed: int = 0,
    demos: Path | None = None,
    log: Callable[[str], None] = lambda _: None,
) -> TwoLevelPolicy:
    """The policy with weights that are made, or were made before, in a directory; `log` is told how it goes on.

    Raises:
        LearningError: scenes to learn from are held out.
    """
    env = recipe.task.make()
    robot, layout = env.get_wrapper_attr("robot"), env.get_wrapper_attr("layout")
    if demos is None:
        seeds = training_seeds(FIRST_PLAN_SEED + seed * SEEDS_OF_A_RUN, recipe.plans)
        shown: Iterable[Motion] = planned_motions(env, recipe.grasps, seeds)
    else:
        dataset = Dataset(demos)
        dataset.warn_if_outdated()
        shown = list(motions_of(dataset))  # refused before anything is trained
    decisions, motions = directory / "decisions.npz", directory / "motions.npz"
    if not decisions.exists():
        rule = CandidateRule(robot, layout, recipe.grasps)
        chooser = train_decisions(env, rule, seed, recipe.decisions, directory / "examples.npz", log)
        save_weights(decisions, chooser, trained_in(env, "decisions", recipe.grasps))
    if not motions.exists():
        network = fit_motions(
            robot, list(shown), recipe.motion_steps, seed, lambda step, loss: log(f"motions, step {step}: {loss:.4f}")
        )
        save_weights(motions, network, trained_in(env, "motions", recipe.grasps))
    env.close()
    return TwoLevelPolicy(LearnedHighLevelPolicy.load(decisions), KeyframePolicy.load(motions), recipe.grasps)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
