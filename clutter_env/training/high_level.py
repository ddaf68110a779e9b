"""Trains a high-level policy: examples from random scenes, then from the states that the learner comes into."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from torch.utils.tensorboard import SummaryWriter

from clutter_env.evaluation.score import held_out_seeds
from clutter_env.policies.high_level.candidates import CandidateRule
from clutter_env.policies.high_level.network import CandidateNetwork
from clutter_env.policies.high_level.policy import LearnedHighLevelPolicy
from clutter_env.policies.runs import DECISIONS_FILE
from clutter_env.policies.weights import WeightsInfo, save_weights
from clutter_env.reporting.files import write_json
from clutter_env.training.high_level_examples import CandidateExamples, examples_of_scene
from clutter_env.training.high_level_fit import HighLevelFitConfig, accuracy, fit_high_level
from clutter_env.training.high_level_rollouts import initial_scenes, roll_out, visited_examples
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


def train_decisions(run: Run) -> list[dict[str, float]]:
    """Train in this process; a resumed run goes on with the examples that it collected.

    All collect `scenes` scenes and fit once; `DecisionsDAgger` then has `rounds` in each of which the learner decides
    in `round_episodes` new scenes, without physics, and is fitted to all examples.
    """
    torch.set_num_threads(1)
    settings = run.settings
    assert isinstance(settings, Decisions)
    env = run.task.make()
    inner: Any = env.unwrapped
    rule = CandidateRule(inner.robot, inner.config.find_layout(), settings.grasps)
    first = _FIRST_SEED + run.seed % 20 * _SEEDS_OF_A_RUN
    examples = _collected(run, env, rule, range(first, first + settings.scenes))
    info = WeightsInfo.of_env("decisions", env, settings.grasps)
    config, history = HighLevelFitConfig(steps=settings.steps, seed=run.seed), []
    with SummaryWriter(str(run.directory / "tensorboard")) as writer:

        def report_loss(step: int, loss: float) -> None:
            writer.add_scalar("train/loss", loss, step)

        def finish_round(number: int, network: CandidateNetwork) -> None:
            """Save and evaluate the policy of a round: on held-out scenes without physics, and on the examples."""
            policy = LearnedHighLevelPolicy(network, rule, info)
            save_weights(run.directory / DECISIONS_FILE, network, info)
            seeds = held_out_seeds(settings.evaluation_episodes)
            outcomes = [roll_out(policy, *start) for start in initial_scenes(env, seeds)]
            cleared = [outcome.clearances for outcome in outcomes if not outcome.failure]
            rates = {"success": len(cleared) / len(outcomes), "clearances": float(np.mean(cleared or math.nan))}
            rates |= accuracy(network, examples)
            history.append({"round": number, "examples": len(examples), **rates})
            write_json(run.directory / HISTORY_FILE, history)
            for name, value in history[-1].items():
                writer.add_scalar(f"held_out/{name}", value, number)

        network = fit_high_level(examples, config, report=report_loss)
        finish_round(0, network)
        if isinstance(settings, DecisionsDAgger):
            rate = _ROUND_RATE * config.learning_rate
            later = replace(config, steps=int(_ROUND_SHARE * settings.steps), learning_rate=rate)
            next_seed = first + _SEEDS_OF_A_RUN // 2
            for number in range(1, settings.rounds + 1):
                seeds = range(next_seed, next_seed + settings.round_episodes)
                next_seed += settings.round_episodes
                policy = LearnedHighLevelPolicy(network, rule, info)
                rollouts = [roll_out(policy, *start) for start in initial_scenes(env, seeds)]
                visited = visited_examples(rollouts, rule, np.random.default_rng(seeds[0]))
                if visited is not None:
                    examples = CandidateExamples.joined((examples, visited))
                taken = sum(not outcome.failure for outcome in rollouts) / len(rollouts)
                writer.add_scalar("train/taken", taken, number)
                network = fit_high_level(examples, later, network, report_loss)
                finish_round(number, network)
    env.close()
    return history


def _collected(run: Run, env: gym.Env[Any, Any], rule: CandidateRule, seeds: range) -> CandidateExamples:
    """The examples of the run; written once they are complete."""
    path = run.directory / EXAMPLES_FILE
    if path.exists():
        return CandidateExamples.load(path)
    parts = [
        examples_of_scene(scene, rule, np.random.default_rng(seed))
        for seed, (scene, _) in zip(seeds, initial_scenes(env, seeds), strict=True)
    ]
    examples = CandidateExamples.joined(parts)
    examples.save(path)
    return examples
