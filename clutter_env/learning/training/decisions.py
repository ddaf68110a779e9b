"""Trains a decider: examples of contacts from random scenes, then from the states that the learner comes into."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import gymnasium as gym
import numpy as np
from torch.utils.tensorboard import SummaryWriter

from clutter_env.learning.comparison.evaluation import held_out_seeds
from clutter_env.learning.decisions.contact_rule import ContactRule
from clutter_env.learning.decisions.dagger import visit
from clutter_env.learning.decisions.decider import LearnedDecider
from clutter_env.learning.decisions.evaluation import evaluate_decisions, score, starts
from clutter_env.learning.decisions.examples import ContactExamples, examples_of_scene
from clutter_env.learning.decisions.fitting import FitConfig, accuracy, fit
from clutter_env.learning.decisions.model_file import DecisionModel
from clutter_env.learning.decisions.network import ContactNetwork
from clutter_env.learning.policies.rl import HISTORY_FILE
from clutter_env.learning.policies.runs import DECISIONS_FILE
from clutter_env.learning.training.run import Run
from clutter_env.reporting.files import write_json

__all__ = ["SCENES", "train_decisions"]

EXAMPLES_FILE = "examples.npz"
SCENES = 700
"""Scenes from which examples are collected, if the run does not say."""
_FIRST_SEED, _SEEDS_OF_A_RUN = 10_000, 20_000
"""Scenes of a training run: its own ones, below those of DAgger and below the held-out ones."""
_ROUND_SHARE = 0.5
"""Gradient steps of a round of DAgger, as a share of the first fit's."""
_ROUND_RATE = 0.3
"""Its learning rate, as a share of the first fit's."""


def train_decisions(run: Run) -> list[dict[str, float]]:
    """Train in this process; a resumed run goes on with the examples that it collected.

    "decisions" collects `episodes` scenes and fits once; "decisions_dagger" then has `rounds` in each of which the
    learner decides in `round_episodes` new scenes, without physics, and is fitted to all examples.
    """
    env = run.task.make()
    inner: Any = env.unwrapped
    rule = ContactRule(inner.robot, inner.config.find_layout(), run.grasps)
    first = _FIRST_SEED + run.seed % 20 * _SEEDS_OF_A_RUN
    examples = _collected(run, env, rule, range(first, first + (run.episodes or SCENES)))
    config, history = FitConfig(steps=run.steps, seed=run.seed), []
    with SummaryWriter(str(run.directory / "tensorboard")) as writer:

        def report_loss(step: int, loss: float) -> None:
            """Log the loss of a gradient step."""
            writer.add_scalar("train/loss", loss, step)

        def finish_round(number: int, network: ContactNetwork) -> None:
            """Save and evaluate the decider of a round."""
            DecisionModel(network, rule).save(run.directory / DECISIONS_FILE)
            entry = {"round": number, "examples": len(examples), **_evaluated(run, env, network, rule, examples)}
            history.append(entry)
            write_json(run.directory / HISTORY_FILE, history)
            for name, value in entry.items():
                writer.add_scalar(f"held_out/{name}", value, number)

        network = fit(examples, config, report=report_loss)
        finish_round(0, network)
        rounds = run.rounds if run.algorithm == "decisions_dagger" else 0
        later = replace(config, steps=int(_ROUND_SHARE * run.steps), learning_rate=_ROUND_RATE * config.learning_rate)
        next_seed = first + _SEEDS_OF_A_RUN // 2
        for number in range(1, rounds + 1):
            seeds = range(next_seed, next_seed + run.round_episodes)
            next_seed += run.round_episodes
            decider = LearnedDecider(network, rule)
            visited = visit(decider, list(starts(env, seeds)), rule, np.random.default_rng(seeds[0]))
            if visited.examples is not None:
                examples = ContactExamples.joined((examples, visited.examples))
            acted = score(visited.outcomes, [None] * len(visited.outcomes))
            writer.add_scalar("train/taken", acted.taken, number)
            network = fit(examples, later, network, report_loss)
            finish_round(number, network)
    env.close()
    return history


def _collected(run: Run, env: gym.Env[Any, Any], rule: ContactRule, seeds: range) -> ContactExamples:
    """The examples of the run; written once they are complete."""
    path = run.directory / EXAMPLES_FILE
    if path.exists():
        return ContactExamples.load(path)
    parts = [
        examples_of_scene(scene, rule, np.random.default_rng(seed))
        for seed, (scene, _) in zip(seeds, starts(env, seeds), strict=True)
    ]
    examples = ContactExamples.joined(parts)
    examples.save(path)
    return examples


def _evaluated(
    run: Run, env: gym.Env[Any, Any], network: ContactNetwork, rule: ContactRule, examples: ContactExamples
) -> dict[str, float]:
    """Success on held-out scenes without physics, clearances, and the accuracy on the examples."""
    seeds = held_out_seeds(run.evaluation_episodes)
    found = evaluate_decisions(LearnedDecider(network, rule), env, seeds)
    return {"success": found.taken, "clearances": found.clearances, **asdict(accuracy(network, examples))}
