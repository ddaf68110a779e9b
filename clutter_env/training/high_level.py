"""Trains a high-level policy: examples from random scenes, then from the states that the learner comes into."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from torch.utils.tensorboard import SummaryWriter

from clutter_env.evaluation.score import held_out_seeds
from clutter_env.learning.decisions.contact_rule import ContactRule
from clutter_env.learning.decisions.dagger import visit
from clutter_env.learning.decisions.decider import LearnedDecider
from clutter_env.learning.decisions.evaluation import evaluate_decisions, score, starts
from clutter_env.learning.decisions.examples import ContactExamples, examples_of_scene
from clutter_env.learning.decisions.fitting import FitConfig, accuracy, fit
from clutter_env.learning.decisions.model_file import DecisionModel
from clutter_env.learning.decisions.network import ContactNetwork
from clutter_env.policies.runs import DECISIONS_FILE
from clutter_env.reporting.files import write_json
from clutter_env.training.reinforcement import HISTORY_FILE
from clutter_env.training.run import Run
from clutter_env.training.settings import Decisions, DecisionsDAgger

EXAMPLES_FILE = "examples.npz"
_FIRST_SEED, _SEEDS_OF_A_RUN = 10_000, 20_000
"""Scenes of a training run: its own ones, below those of DAgger and below the held-out ones."""
_ROUND_SHARE = 0.5
"""Gradient steps of a round of DAgger, as a share of the first fit's."""
_ROUND_RATE = 0.3
"""Its learning rate, as a share of the first fit's."""


def train_decisions(run: Run, settings: Decisions) -> list[dict[str, float]]:
    """Train in this process; a resumed run goes on with the examples that it collected.

    All collect `scenes` scenes and fit once; `DecisionsDAgger` then has `rounds` in each of which the learner decides in
    `round_episodes` new scenes, without physics, and is fitted to all examples.
    """
    torch.set_num_threads(1)
    env = run.task.make()
    inner: Any = env.unwrapped
    rule = ContactRule(inner.robot, inner.config.find_layout(), settings.grasps)
    first = _FIRST_SEED + run.seed % 20 * _SEEDS_OF_A_RUN
    examples = _collected(run, env, rule, range(first, first + settings.scenes))
    config, history = FitConfig(steps=settings.steps, seed=run.seed), []
    with SummaryWriter(str(run.directory / "tensorboard")) as writer:

        def report_loss(step: int, loss: float) -> None:
            writer.add_scalar("train/loss", loss, step)

        def finish_round(number: int, network: ContactNetwork) -> None:
            """Save and evaluate the policy of a round: on held-out scenes without physics, and on the examples."""
            DecisionModel(network, rule).save(run.directory / DECISIONS_FILE)
            seeds = held_out_seeds(settings.evaluation_episodes)
            found = evaluate_decisions(LearnedDecider(network, rule), env, seeds)
            rates = {"success": found.taken, "clearances": found.clearances, **asdict(accuracy(network, examples))}
            history.append({"round": number, "examples": len(examples), **rates})
            write_json(run.directory / HISTORY_FILE, history)
            for name, value in history[-1].items():
                writer.add_scalar(f"held_out/{name}", value, number)

        network = fit(examples, config, report=report_loss)
        finish_round(0, network)
        if isinstance(settings, DecisionsDAgger):
            rate = _ROUND_RATE * config.learning_rate
            later = replace(config, steps=int(_ROUND_SHARE * settings.steps), learning_rate=rate)
            next_seed = first + _SEEDS_OF_A_RUN // 2
            for number in range(1, settings.rounds + 1):
                seeds = range(next_seed, next_seed + settings.round_episodes)
                next_seed += settings.round_episodes
                policy = LearnedDecider(network, rule)
                visited = visit(policy, list(starts(env, seeds)), rule, np.random.default_rng(seeds[0]))
                if visited.examples is not None:
                    examples = ContactExamples.joined((examples, visited.examples))
                taken = score(visited.outcomes, [None] * len(visited.outcomes)).taken
                writer.add_scalar("train/taken", taken, number)
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
